"""Sends a walk along another path: the body is moved by a new path and heading, and the feet are planted again."""

from __future__ import annotations

import numpy as np

from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.data.poses import Poses, multiply, smooth, yaw_matrix, yaw_quaternion
from motiongen_ardy.data.replant import Replanted, replant

# Smoothing that separates the path of the body from its sway, seconds of a Gaussian.
WAY_SIGMA_S = 0.4


def way_of(poses: Poses, fps: float) -> np.ndarray:
    """The smooth path (T, 2), x and z in metres, about which the root sways."""
    return smooth(poses.root[:, [0, 2]], WAY_SIGMA_S * fps)


def warp(
    skeleton: Skeleton,
    poses: Poses,
    fps: float,
    heading: np.ndarray,
    *,
    travel: np.ndarray,
    stride: np.ndarray,
    flatten: np.ndarray | None = None,
    widen: np.ndarray | None = None,
) -> Replanted:
    """Turn body and path of a motion (T frames) and plant its feet again.

    heading: (T,), radians by which the body is turned about +Y. travel: (T,), radians by which its path is turned.
    stride: (T,), scale of its path relative to the capture; 0 keeps it on the spot. flatten, widen: as for `replant`.
    """
    way = way_of(poses, fps)
    steps = np.diff(way, axis=0)
    middle = (travel[1:] + travel[:-1]) / 2
    scale = (stride[1:] + stride[:-1]) / 2
    cosine, sine = np.cos(middle), np.sin(middle)
    turned = np.stack([cosine * steps[:, 0] + sine * steps[:, 1], cosine * steps[:, 1] - sine * steps[:, 0]], axis=-1)
    new_way = np.concatenate([way[:1], way[:1] + np.cumsum(turned * scale[:, None], axis=0)])
    sway = poses.root.copy()
    sway[:, [0, 2]] -= way
    root = (yaw_matrix(heading) @ sway[..., None])[..., 0]
    root[:, [0, 2]] += new_way
    quaternions = poses.quaternions.copy()
    quaternions[:, 0] = multiply(yaw_quaternion(heading), quaternions[:, 0])
    return replant(skeleton, Poses(quaternions, root, poses.contacts), flatten, widen)
