"""Motion to write and read again."""

from __future__ import annotations

import torch

from motiongen_ardy.core.rotation import axis_angle_to_matrix
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.formats.stored import StoredMotion, from_pose


def random_motion(skeleton: Skeleton, num_frames: int, seed: int, fps: int = 20, size: float = 0.7) -> StoredMotion:
    """A motion in which every joint turns smoothly, `size` radians or so, and the root walks about and spins."""
    random = torch.Generator().manual_seed(seed)
    time_s = torch.arange(num_frames, dtype=torch.float64)[:, None, None] / fps
    shape = (1, skeleton.num_joints, 3)
    phase, rate = (torch.rand(shape, generator=random, dtype=torch.float64) * 6 for _ in range(2))
    vectors = size * torch.sin(phase + rate * time_s)
    vectors[:, 0, 1] += 2 * time_s[:, 0, 0]
    root = torch.randn(1, 3, generator=random, dtype=torch.float64) + time_s[:, 0] * torch.tensor([0.5, 0.01, 1.2])
    return from_pose(skeleton, axis_angle_to_matrix(vectors), root, fps, source="random motion", text="a test")
