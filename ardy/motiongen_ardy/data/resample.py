"""Changes the frame rate: global rotations by spherical interpolation, positions linearly."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.rotation import matrix_to_quaternion, quaternion_to_matrix, slerp


def resampled_length(num_frames: int, source_fps: float, target_fps: float) -> int:
    """The number of frames at the target rate between the first and the last source frame."""
    return int((num_frames - 1) * target_fps / source_fps + 1e-6) + 1


def resample(
    global_rotations: Tensor, positions: Tensor, source_fps: float, target_fps: float
) -> tuple[Tensor, Tensor]:
    """Rotations (T, J, 3, 3) and positions (T, K, 3) at another rate; frame 0 stays frame 0.

    Euler channels must never be interpolated (they jump by whole turns); these are matrices. Interpolating global
    rather than parent-relative rotations keeps the direction of each bone free of its ancestors' error.
    """
    num_frames = resampled_length(global_rotations.shape[0], source_fps, target_fps)
    # The tiny offset keeps a target frame that coincides with a source frame from falling just before it.
    at = torch.arange(num_frames, dtype=torch.float64) * (source_fps / target_fps)
    first = (at + 1e-6).long().clamp(max=global_rotations.shape[0] - 1)
    second = (first + 1).clamp(max=global_rotations.shape[0] - 1)
    fraction = (at - first).clamp(min=0)
    quaternions = matrix_to_quaternion(global_rotations)
    mixed = slerp(quaternions[first], quaternions[second], fraction[:, None].expand(-1, quaternions.shape[1]))
    weight = fraction[:, None, None]
    return quaternion_to_matrix(mixed), (1 - weight) * positions[first] + weight * positions[second]
