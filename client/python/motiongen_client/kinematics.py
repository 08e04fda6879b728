"""Kinematics: rotations and forward kinematics with numpy, enough to turn frames into joint positions.

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
    """(..., 3, 3) -> (...) the heading about +Y in radians: 0 toward +Z, +pi/2 toward +X."""
    return np.arctan2(rotation[..., 0, 2], rotation[..., 2, 2])


def matrix_to_quaternion(rotation: Array) -> Array:
    """(..., 3, 3) rotation matrices -> (..., 4) unit quaternions w x y z, w not negative."""
    matrix = np.asarray(rotation, np.float64)
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    trace = diagonal.sum(axis=-1)
    # Row i: 4 q_i q for each component i; the row of the greatest component is the most accurate.
    squares = np.concatenate([1 + trace[..., None], 1 - trace[..., None] + 2 * diagonal], axis=-1)
    products = np.zeros((*trace.shape, 4, 4))
    products[..., range(4), range(4)] = squares
    for first, (row, column) in enumerate(((2, 1), (0, 2), (1, 0)), 1):
        products[..., 0, first] = products[..., first, 0] = matrix[..., row, column] - matrix[..., column, row]
    for first, second in ((1, 2), (1, 3), (2, 3)):
        total = matrix[..., first - 1, second - 1] + matrix[..., second - 1, first - 1]
        products[..., first, second] = products[..., second, first] = total
    best = np.argmax(squares, axis=-1)
    chosen = np.take_along_axis(products, best[..., None, None], axis=-2)[..., 0, :]
    unit = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    quaternion: Array = np.where(unit[..., :1] < 0, -unit, unit)
    return quaternion


def axis_angle_to_quaternion(rotation_vector: Array) -> Array:
    """(..., 3) axis times angle in radians -> (..., 4) unit quaternions w x y z."""
    vector = np.asarray(rotation_vector, np.float64)
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    # sin(a/2)/a by numpy's sinc, which is defined at 0
    return np.concatenate([np.cos(angle / 2), vector * np.sinc(angle / (2 * np.pi)) / 2], axis=-1)


def facing_rad(positions_m: Array, hip_joints: tuple[int, int]) -> Array:
    """(..., J, 3) joint positions -> (...) the heading about +Y: perpendicular to the line of the hips."""
    across = positions_m[..., hip_joints[0], :] - positions_m[..., hip_joints[1], :]
    return np.arctan2(across[..., 2], -across[..., 0])
