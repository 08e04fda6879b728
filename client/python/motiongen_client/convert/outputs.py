"""The additional outputs of a session: checks them, and reads those that are not sent as float32."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from motiongen_client.convert.smallest_three import unpacked_quaternions
from motiongen_client.errors import ProtocolViolation
from motiongen_client.motion import (
    GLOBAL_ROTATION_BLOCK,
    POSITIONS_BLOCK,
    QPOS_BLOCK,
    ROOT_BLOCK,
    Float32,
    Rig,
)

_NUMBERS_OF_A_JOINT = {POSITIONS_BLOCK: 3, GLOBAL_ROTATION_BLOCK: 4, "joint_velocities_mps": 3}
_NUMBERS_OF_A_ROBOT = {QPOS_BLOCK: 36, "g1_qvel": 35}
WIDEST_ROW = 2**14
"""Limit on the numbers in a frame row, with its outputs; a row of 512 joints with every output has 7246."""


def check_outputs(given: Mapping[str, int], asked: Sequence[str], rig: Rig) -> None:
    """Raise ProtocolViolation unless the given outputs, name -> width, are those asked for, in the same order.

    rig: its number of joints determines the widths of known outputs.
    """
    if list(given) != list(asked):
        raise ProtocolViolation(f"frames have the outputs {list(given)}; {list(asked)} were asked for")
    known = {name: each * rig.num_joints for name, each in _NUMBERS_OF_A_JOINT.items()} | _NUMBERS_OF_A_ROBOT
    for name, width in given.items():
        if known.get(name, width) != width:
            raise ProtocolViolation(f"rig {rig.rig_id}: output {name} has width {width}, not {known[name]}")
    if rig.own_width + sum(given.values()) > WIDEST_ROW:
        raise ProtocolViolation(f"rig {rig.rig_id}: a row with {dict(given)} is wider than {WIDEST_ROW} numbers")


def make_absolute(rows: Float32, rig: Rig, origin: Float32) -> None:
    """Add an origin (3,), world metres, to the positions among the outputs of rows (T, row_width), in place."""
    if POSITIONS_BLOCK in rig.outputs:
        columns = rig.block_columns[POSITIONS_BLOCK]
        rows[:, columns] += np.tile(origin, rig.outputs[POSITIONS_BLOCK] // 3)
    if QPOS_BLOCK in rig.outputs:
        start = rig.block_columns[QPOS_BLOCK].start
        rows[:, start : start + 3] += origin[[2, 0, 1]]  # the robot's forward, left, up are our z, x, y


def quantised_bytes(name: str, width: int) -> int:
    """Bytes of an output of `width` numbers in a quantised frame."""
    return width if name == GLOBAL_ROTATION_BLOCK else 2 * width  # the four numbers of a rotation take four bytes


def read_quantised(data: NDArray[np.uint8], rig: Rig, rows: Float32) -> None:
    """Read the outputs' bytes (T, N) into their columns of rows (T, row_width), which already contain the roots."""
    start, roots = 0, rows[:, rig.block_columns[ROOT_BLOCK]]
    for name, width in rig.outputs.items():
        end = start + quantised_bytes(name, width)
        part = np.ascontiguousarray(data[:, start:end])
        start = end
        if name == GLOBAL_ROTATION_BLOCK:
            rows[:, rig.block_columns[name]] = unpacked_quaternions(part.view("<u4")).reshape(len(rows), -1)
            continue
        values = part.view("<i2") / np.float32(1000)
        rows[:, rig.block_columns[name]] = values + np.tile(roots, width // 3) if name == POSITIONS_BLOCK else values
