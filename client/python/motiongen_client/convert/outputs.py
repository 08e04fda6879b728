"""What a session asked for besides, where its numbers are not float32."""

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
"""Numbers in a frame row, with its outputs; one of 512 joints with every output there is has 7246."""


def check_outputs(given: Mapping[str, int], asked: Sequence[str], rig: Rig) -> None:
    """Raise ProtocolViolation unless these are the outputs, name -> width, that were asked for, in their order.

    rig: whose joints they are of; those whose names are known have a width by it.
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
    """Add an origin (3), world metres, to the places among the outputs in rows (T, row_width), in place."""
    if POSITIONS_BLOCK in rig.outputs:
        columns = rig.block_columns[POSITIONS_BLOCK]
        rows[:, columns] += np.tile(origin, rig.outputs[POSITIONS_BLOCK] // 3)
    if QPOS_BLOCK in rig.outputs:
        start = rig.block_columns[QPOS_BLOCK].start
        rows[:, start : start + 3] += origin[[2, 0, 1]]  # forward, left, up of the robot are our z, x, y


def quantised_bytes(name: str, width: int) -> int:
    """Of an output of so many numbers in a quantised frame."""
    return width if name == GLOBAL_ROTATION_BLOCK else 2 * width  # four numbers of a rotation are four bytes


def read_quantised(data: NDArray[np.uint8], rig: Rig, rows: Float32) -> None:
    """The outputs' bytes (T, N) into their columns of rows (T, row_width), whose roots are there already."""
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
