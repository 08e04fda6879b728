"""Encodes the additional outputs that a session asked for, if its frames are not float32."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.types import ChannelBlock, Float32Array
from motiongen_server.rpc.convert.smallest_three import smallest_three

_POSITIONS, _ROTATIONS, _VELOCITIES, _QPOS = (
    "joint_positions_m",
    "joint_global_rotation_quat_wxyz",
    "joint_velocities_mps",
    "g1_qpos",
)
_LARGEST = 2**15 - 1


def is_quantised(name: str) -> bool:
    """Whether an output can be sent QUANTISED."""
    return name in (_POSITIONS, _ROTATIONS, _VELOCITIES)


def _parts(rows: Float32Array, blocks: Sequence[ChannelBlock]) -> Iterator[tuple[str, Float32Array]]:
    """The columns of each block."""
    start = 0
    for block in blocks:
        yield block.name, rows[:, start : start + block.width]
        start += block.width


def make_relative(rows: Float32Array, blocks: Sequence[ChannelBlock], origin: Float32Array) -> None:
    """Subtract an origin (3), world metres, from the positions in rows (T, W) of blocks, in place."""
    for name, part in _parts(rows, blocks):
        if name == _POSITIONS:
            part -= np.tile(origin, part.shape[1] // 3)
        elif name == _QPOS:
            part[:, :3] -= origin[[2, 0, 1]]  # the robot's forward, left and up are our z, x and y


def quantised_outputs(
    rows: Float32Array, blocks: Sequence[ChannelBlock], roots: Float32Array
) -> list[NDArray[np.uint8]]:
    """The bytes (T, N) of each block of rows (T, W), little endian. roots: (T, 3), to which positions are relative."""
    found = []
    for name, part in _parts(rows, blocks):
        if name == _ROTATIONS:
            found.append(smallest_three(part.reshape(len(part), -1, 4)).view(np.uint8).reshape(len(part), -1))
            continue
        values = part - np.tile(roots, part.shape[1] // 3) if name == _POSITIONS else part
        whole = np.clip(np.rint(values.astype(np.float64) * 1000), -_LARGEST, _LARGEST).astype("<i2")
        found.append(whole.view(np.uint8).reshape(len(part), -1))
    return found
