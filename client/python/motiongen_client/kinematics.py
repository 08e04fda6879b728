"""Rotations and forward kinematics with numpy, enough to turn frames into joint positions.

Quaternions are unit, in the order w, x, y, z; matrices act on column vectors; right-handed, +Y up, +Z forward, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


def quaternion_to_matrix(quaternion_wxyz: Array) -> Array:
    """(..., 4) quaternions of any length but zero -> (..., 3, 3) rotation matrices."""
    w, x, y, z = np.moveaxis(quaternion_wxyz / np.linalg.norm(quaternion_wxyz, axis=-1, keepdims=True), -1, 0)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, axis=-1).reshape(*w.shape, 3, 3)


def forward_kinematics(
    parents: Sequence[int], offsets_m: Array, root_translation_m: Array, joint_rotation_quat_wxyz: Array
) -> tuple[Array, Array]:
    """World positions and world rotations of every joint.

    parents: J indices, -1 for the root, parents first; offsets_m: (J, 3) from the parent in the neutral pose;
    root_translation_m: (..., 3); joint_rotation_quat_wxyz: (..., J, 4) relative to the parent.
    Returns positions (..., J, 3) in metres and rotations (..., J, 3, 3): G_j = G_a R_j, q_j = q_a + G_a o_j.
    """
    local = quaternion_to_matrix(joint_rotation_quat_wxyz)
    rotations = [local[..., 0, :, :]]
    positions = [root_translation_m]
    for joint in range(1, len(parents)):
        parent = parents[joint]
        rotations.append(rotations[parent] @ local[..., joint, :, :])
        positions.append(positions[parent] + rotations[parent] @ offsets_m[joint])
    return np.stack(positions, axis=-2), np.stack(rotations, axis=-3)


def heading_rad(rotation: Array) -> Array:
    """(..., 3, 3) -> (...) the facing about +Y in radians: 0 toward +Z, +pi/2 toward +X."""
    return np.arctan2(rotation[..., 0, 2], rotation[..., 2, 2])
