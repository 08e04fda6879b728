"""FrameCoding: how the frames of one session are encoded for its client."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import motion_pb2
from motiongen_server.engine.types import ChannelBlock, Float32Array
from motiongen_server.rpc.convert.output_coding import make_relative, quantised_outputs
from motiongen_server.rpc.convert.smallest_three import smallest_three

F32, F16, QUANTISED = (
    motion_pb2.SCALAR_TYPE_F32_LE,
    motion_pb2.SCALAR_TYPE_F16_LE,
    motion_pb2.SCALAR_TYPE_QUANTISED,
)
SCALAR_TYPES = (F32, F16, QUANTISED)
ROOT_WIDTH, NUM_CONTACTS = 3, 4
_FARTHEST_MM = 2**31 - 1
_LARGEST_HALF = 65504.0
"""The largest finite half. A trajectory may ask for speeds beyond it: across all the world within one frame."""
_JUMP_M = 1.0
"""No character moves this far from one frame to the next."""


@dataclass(frozen=True, slots=True)
class FrameCoding:
    """scalar_type: the contract's number. num_joints: of the rig; a row has root, quaternions, contacts, outputs."""

    scalar_type: int
    num_joints: int
    outputs: tuple[ChannelBlock, ...] = ()

    def stretches(self, rows: Float32Array) -> list[tuple[int, int]]:
        """Ranges (begin, end) of the rows (T, row_width) that may be encoded together.

        Halves hold distances from the first root: after a jump, which only a cut makes, they could be metres off.
        """
        if self.scalar_type != F16:
            return [(0, len(rows))]
        jumps = np.abs(np.diff(rows[:, :ROOT_WIDTH], axis=0)).max(axis=1, initial=0.0) > _JUMP_M
        return list(pairwise([0, *(np.flatnonzero(jumps) + 1).tolist(), len(rows)]))

    def encode(self, rows: Float32Array) -> tuple[memoryview, Float32Array | None]:
        """The bytes of rows (T, row_width), and the origin (3) of their roots; None if they have none."""
        if self.scalar_type == F16:
            origin, halves = rows[0, :ROOT_WIDTH].copy(), rows.copy()
            halves[:, :ROOT_WIDTH] -= origin
            make_relative(halves[:, self._own_width :], self.outputs, origin)
            return _bytes(np.clip(halves, -_LARGEST_HALF, _LARGEST_HALF).astype("<f2")), origin
        if self.scalar_type == QUANTISED:
            return _bytes(self._quantised(rows)), None
        return _bytes(np.ascontiguousarray(rows, "<f4")), None

    @property
    def _own_width(self) -> int:
        """The numbers in a row before the outputs."""
        return ROOT_WIDTH + 4 * self.num_joints + NUM_CONTACTS

    def _quantised(self, rows: Float32Array) -> NDArray[np.uint8]:
        end = ROOT_WIDTH + 4 * self.num_joints
        places = np.clip(np.rint(rows[:, :ROOT_WIDTH].astype(np.float64) * 1000), -_FARTHEST_MM, _FARTHEST_MM)
        turns = smallest_three(rows[:, ROOT_WIDTH:end].reshape(len(rows), self.num_joints, 4))
        contacts = (rows[:, end : end + NUM_CONTACTS] > 0.5) @ np.array([1, 2, 4, 8])
        parts = [
            places.astype("<i4").view(np.uint8).reshape(len(rows), -1),
            turns.view(np.uint8).reshape(len(rows), -1),
            contacts.astype(np.uint8)[:, None],
            *quantised_outputs(rows[:, self._own_width :], self.outputs, rows[:, :ROOT_WIDTH]),
        ]
        return np.ascontiguousarray(np.concatenate(parts, axis=1))


PLAIN = FrameCoding(F32, 0)
"""The coding of sessions that ask for nothing else."""


def _bytes(array: NDArray[np.generic]) -> memoryview:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
