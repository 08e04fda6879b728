"""A mesh for display: one slim diamond per bone, which moves with the joint at which the bone starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motiongen_ardy.core.skeleton import Skeleton

_WIDTH = 0.12  # of the bone's length
_WAIST = 0.2  # where along the bone it is widest
_FACES = np.array([(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 1, 4), (5, 1, 2), (5, 2, 3), (5, 3, 4), (5, 4, 1)])


@dataclass(frozen=True, eq=False)
class BoneMesh:
    """Triangles, each with its own three vertices, in the neutral pose with the root at the origin.

    positions, normals: (V, 3) float32, metres. joints: (V), the joint that each vertex moves with.
    """

    positions: np.ndarray
    normals: np.ndarray
    joints: np.ndarray


def bone_mesh(skeleton: Skeleton) -> BoneMesh:
    """The diamonds of all bones with a length above zero."""
    corners, joints = [], []
    for joint, parent in enumerate(skeleton.parents):
        bone = skeleton.offsets[joint]
        length = float(np.linalg.norm(bone))
        if joint == 0 or length < 1e-4:
            continue
        aside = np.cross(bone, np.eye(3)[int(np.abs(bone).argmin())])
        aside *= _WIDTH * length / np.linalg.norm(aside)
        across = np.cross(bone, aside) / length
        waist = _WAIST * bone
        points = np.stack([np.zeros(3), waist + aside, waist + across, waist - aside, waist - across, bone])
        corners.append((skeleton.neutral_joints[parent] + points)[_FACES])  # (8, 3, 3)
        joints += [parent] * _FACES.size
    triangles = np.concatenate(corners)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = triangles.reshape(-1, 3).astype(np.float32)
    return BoneMesh(positions, np.repeat(normals, 3, axis=0).astype(np.float32), np.array(joints))
