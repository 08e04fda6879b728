"""FrameReader: reads frames from the bytes of a chunk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import motion_pb2
from motiongen_client.convert.outputs import make_absolute, quantised_bytes, read_quantised
from motiongen_client.convert.smallest_three import unpacked_quaternions
from motiongen_client.errors import ProtocolViolation
from motiongen_client.motion import CONTACT_BLOCK, GLOBAL_ROTATION_BLOCK, ROOT_BLOCK, ROTATION_BLOCK, Float32, Rig
from motiongen_client.types import FrameFormat

SCALAR_TYPES = {
    FrameFormat.F32: motion_pb2.SCALAR_TYPE_F32_LE,
    FrameFormat.F16: motion_pb2.SCALAR_TYPE_F16_LE,
    FrameFormat.QUANTISED: motion_pb2.SCALAR_TYPE_QUANTISED,
}
MOST_CHUNK_BYTES = 2**28
"""Limit on the rows of one chunk as float32; quantised ones may have blocks that take no bytes on the wire."""
_PLACE_BYTES = 12


@dataclass(frozen=True)
class FrameReader:
    """Reads the chunks of one session. frame_format: as requested."""

    rig: Rig
    frame_format: FrameFormat = FrameFormat.F32

    def rows(self, message: motion_pb2.FrameChunk, before: Float32 | None = None) -> Float32:
        """(T, row_width) float32. before: the row of the frame before; quantised quaternions continue its signs.

        Raises ProtocolViolation if the chunk has another scalar type, or its bytes do not match its frame count.
        """
        if message.scalar_type != SCALAR_TYPES[self.frame_format]:
            given = f"a chunk has scalar type {message.scalar_type}"
            raise ProtocolViolation(f"{given}; {self.frame_format.name} was asked for")
        count = message.frame_count
        expected = count * self.row_bytes
        if count < 1 or len(message.data) != expected:
            raise ProtocolViolation(
                f"a chunk of {count} frames has {len(message.data)} bytes, not the {expected} of its rig"
            )
        if count * self.rig.row_width * 4 > MOST_CHUNK_BYTES:
            raise ProtocolViolation(f"a chunk has {count} frames of {self.rig.row_width} numbers, more than are held")
        if self.frame_format is FrameFormat.QUANTISED:
            return self._continued(self._quantised(np.frombuffer(message.data, np.uint8).reshape(count, -1)), before)
        if self.frame_format is FrameFormat.F16:
            return self._halves(message)
        rows = np.frombuffer(message.data, dtype="<f4").reshape(count, self.rig.row_width)
        return rows.astype(np.float32, copy=False)

    @property
    def row_bytes(self) -> int:
        """Bytes of one frame."""
        if self.frame_format is FrameFormat.QUANTISED:
            return self._own_bytes + sum(quantised_bytes(*output) for output in self.rig.outputs.items())
        return self.rig.row_width * (2 if self.frame_format is FrameFormat.F16 else 4)

    @property
    def _own_bytes(self) -> int:
        """Bytes of one quantised frame before the outputs."""
        return _PLACE_BYTES + 4 * len(self.rig.joint_names) + 1

    def _halves(self, message: motion_pb2.FrameChunk) -> Float32:
        if len(message.root_origin_m) != 3:
            raise ProtocolViolation(f"a chunk of halves has an origin of {len(message.root_origin_m)} numbers, not 3")
        rows = np.frombuffer(message.data, "<f2").reshape(message.frame_count, self.rig.row_width).astype(np.float32)
        origin = np.array(message.root_origin_m, np.float32)
        rows[:, self.rig.block_columns[ROOT_BLOCK]] += origin
        make_absolute(rows, self.rig, origin)
        turns = rows[:, self.rig.block_columns[ROTATION_BLOCK]].reshape(len(rows), -1, 4)
        turns /= np.maximum(np.linalg.norm(turns, axis=-1, keepdims=True), 1e-6)
        rows[:, self.rig.block_columns[ROTATION_BLOCK]] = turns.reshape(len(rows), -1)
        return rows

    def _quantised(self, data: NDArray[np.uint8]) -> Float32:
        columns, rows = self.rig.block_columns, np.zeros((len(data), self.rig.row_width), np.float32)
        places = np.ascontiguousarray(data[:, :_PLACE_BYTES]).view("<i4")
        rows[:, columns[ROOT_BLOCK]] = places / 1000.0
        own = self._own_bytes
        packed = np.ascontiguousarray(data[:, _PLACE_BYTES : own - 1]).view("<u4")
        rows[:, columns[ROTATION_BLOCK]] = unpacked_quaternions(packed).reshape(len(data), -1)
        rows[:, columns[CONTACT_BLOCK]] = data[:, own - 1 : own] >> np.arange(4) & 1
        read_quantised(data[:, own:], self.rig, rows)
        return rows

    def _continued(self, rows: Float32, before: Float32 | None) -> Float32:
        """The same poses, with the sign of each quaternion chosen nearest to that of the frame before."""
        for name in (ROTATION_BLOCK, GLOBAL_ROTATION_BLOCK):
            columns = self.rig.block_columns.get(name)
            if columns is None:
                continue
            turns = rows[:, columns].reshape(len(rows), -1, 4)
            last = turns[:1] if before is None else before[columns].reshape(1, -1, 4)
            dots = (turns * np.concatenate([last, turns[:-1]])).sum(axis=-1, keepdims=True)
            turns *= np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0).astype(np.float32)
            rows[:, columns] = turns.reshape(len(rows), -1)
        return rows
