"""Fits the rotations of a pose to given places: of all joints, or of one limb's end. One frame at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motiongen_client.kinematics import forward_kinematics, matrix_to_quaternion
from motiongen_client.motion import Rig

Float64 = NDArray[np.float64]
_ROUNDS = 60
_LIMB_BONES = 2
_NEAR_M = 1e-5


def fitted(rig: Rig, positions_m: Float64, like: Float64) -> Float64:
    """(J, 3, 3) world rotations of a pose whose joints are at positions_m (J, 3).

    like: rotations of another pose; bones twist no more than necessary from it. A joint with several children is
    rotated to fit them best (Kabsch 1976); a joint without children keeps its rotation relative to its parent.
    """
    children: list[list[int]] = [[] for _ in rig.parents]
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            children[parent].append(joint)
    turned = like.copy()
    for joint, below in enumerate(children):
        parent = rig.parents[joint]
        if parent >= 0:
            turned[joint] = turned[parent] @ like[parent].T @ like[joint]
        if below:
            is_at = (turned[joint] @ rig.offsets_m[below].astype(np.float64).T).T
            turned[joint] = _least_turn(is_at, positions_m[below] - positions_m[joint]) @ turned[joint]
    return turned


def reached(rig: Rig, root_m: Float64, local: Float64, joint: int, place_m: Float64) -> Float64:
    """(J, 3, 3) local rotations with a joint at a place, or as near as it gets by turning the two bones above it.

    root_m: (3,) of the root; local: (J, 3, 3). By cyclic coordinate descent (Wang and Chen 1991).
    """
    bent = local.copy()
    above = rig.parents[joint]
    chain: list[int] = []
    while above > 0 and len(chain) < _LIMB_BONES:
        chain.append(above)
        above = rig.parents[above]
    for _ in range(_ROUNDS):
        for turning in chain:
            positions, rotations = pose(rig, root_m, bent)
            if np.linalg.norm(positions[joint] - place_m) < _NEAR_M:
                return bent
            arm, wanted = positions[joint] - positions[turning], place_m - positions[turning]
            parent = rotations[rig.parents[turning]]
            bent[turning] = parent.T @ _least_turn(arm[None], wanted[None]) @ parent @ bent[turning]
    return bent


def pose(rig: Rig, root_m: Float64, local: Float64) -> tuple[Float64, Float64]:
    """World positions (J, 3) and rotations (J, 3, 3) from local rotations (J, 3, 3)."""
    positions, rotations = forward_kinematics(rig.parents, rig.offsets_m, root_m, matrix_to_quaternion(local))
    return np.asarray(positions, np.float64), np.asarray(rotations, np.float64)


def to_local(rig: Rig, rotations: Float64) -> Float64:
    """(J, 3, 3) world rotations -> rotations relative to the parents."""
    parents = np.array(rig.parents)
    local = rotations.copy()
    local[1:] = np.swapaxes(rotations[parents[1:]], -1, -2) @ rotations[1:]
    return local


def axis_angles(local: Float64) -> Float64:
    """(J, 3, 3) rotations -> (J, 3), axis times angle in radians, 0 to pi."""
    quaternions = matrix_to_quaternion(local)
    sines = np.linalg.norm(quaternions[:, 1:], axis=-1, keepdims=True)
    angles = 2 * np.arctan2(sines, quaternions[:, :1])
    # near no rotation, the axis is arbitrary, and angle / sine approaches 2
    return np.asarray(quaternions[:, 1:] * np.where(sines > 1e-9, angles / np.maximum(sines, 1e-9), 2.0))


def _least_turn(before: Float64, after: Float64) -> Float64:
    """(3, 3): the rotation that brings vectors (K, 3) nearest to others; for one pair, the smallest such rotation."""
    if len(before) > 1:
        left, _, right = np.linalg.svd(after.T @ before)
        sign = np.sign(np.linalg.det(left @ right))
        return np.asarray(left @ np.diag([1.0, 1.0, sign]) @ right)
    lengths = np.linalg.norm(before[0]) * np.linalg.norm(after[0])
    if lengths < 1e-12:
        return np.eye(3)
    axis, cosine = np.cross(before[0], after[0]) / lengths, float(before[0] @ after[0]) / lengths
    if cosine < -1 + 1e-9:  # opposite vectors: half a turn about any perpendicular axis
        side = np.cross(before[0], np.eye(3)[np.argmin(np.abs(before[0]))])
        side /= np.linalg.norm(side)
        return np.asarray(2 * np.outer(side, side) - np.eye(3))
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + cosine))
