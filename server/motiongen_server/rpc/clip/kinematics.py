"""Forward kinematics with numpy: where the joints of frames are that go over the wire."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.types import Float32Array, RigLayout
from motiongen_server.engine.types.facts import ROOT_BLOCK, ROTATION_BLOCK
from motiongen_server.rpc.convert.rotations import rotation_matrices

Float64 = NDArray[np.float64]


def posed(rig: RigLayout, rows: Float32Array) -> tuple[Float64, Float64]:
    """World positions (T, J, 3) in metres and world rotations (T, J, 3, 3) of rows (T, row_width)."""
    columns, start = {}, 0
    for block in rig.blocks:
        columns[block.name] = slice(start, start + block.width)
        start += block.width
    num_joints = len(rig.joint_names)
    local = rotation_matrices(rows[:, columns[ROTATION_BLOCK]].astype(np.float64).reshape(-1, num_joints, 4))
    offsets = rig.neutral_offsets.astype(np.float64)
    positions = [rows[:, columns[ROOT_BLOCK]].astype(np.float64)]
    rotations = [local[:, 0]]
    for joint in range(1, num_joints):
        parent = rig.parents[joint]
        rotations.append(rotations[parent] @ local[:, joint])
        positions.append(positions[parent] + rotations[parent] @ offsets[joint])
    return np.stack(positions, axis=1), np.stack(rotations, axis=1)


def heading(rig: RigLayout, positions: Float64, rotations: Float64) -> Float64:
    """(T) radians about the up axis, 0 toward +Z: the line of the hips turned by 90 degrees, or the root's rotation."""
    if rig.hip_joints is None:
        return np.arctan2(rotations[:, 0, 0, 2], rotations[:, 0, 2, 2])
    right, left = rig.hip_joints
    across = positions[:, right] - positions[:, left]
    return np.arctan2(across[:, 2], -across[:, 0])
