"""Robot states to test with."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.robot.g1 import load_g1


def random_qpos(num_frames: int, seed: int) -> Tensor:
    """Rows (T, 36) float64 with random place and heading, every hinge within its range."""
    robot = load_g1()
    random = torch.Generator().manual_seed(seed)
    root = torch.randn(num_frames, 7, generator=random, dtype=torch.float64)
    quaternion = root[:, 3:] / root[:, 3:].norm(dim=1, keepdim=True)
    fraction = torch.rand(num_frames, len(robot.hinges), generator=random, dtype=torch.float64)
    return torch.cat([root[:, :3], quaternion, torch.lerp(robot.lower, robot.upper, fraction)], dim=1)


def walking_qpos(num_frames: int, rate_hz: float) -> Tensor:
    """Rows (T, 36) float64 similar to a walk, smooth at any rate: hips, knees and arms swing, the root turns."""
    robot = load_g1()
    time_s = torch.arange(num_frames, dtype=torch.float64) / rate_hz
    phase = 2 * torch.pi * 0.8 * time_s
    rows = torch.zeros(num_frames, 36, dtype=torch.float64)
    rows[:, 0], rows[:, 2] = 0.6 * time_s, 0.78 + 0.01 * torch.cos(2 * phase)
    rows[:, 3], rows[:, 6] = torch.cos(0.2 * time_s), torch.sin(0.2 * time_s)
    for hinge, size, offset in (
        ("left_hip_pitch", 0.4, 0.0), ("right_hip_pitch", -0.4, 0.0), ("left_knee", 0.3, 0.4),
        ("right_knee", -0.3, 0.4), ("left_shoulder_pitch", -0.3, 0.0), ("right_shoulder_pitch", 0.3, 0.0),
        ("left_elbow", 0.1, 0.6),
    ):  # fmt: skip
        rows[:, 7 + robot.hinges.index(hinge)] = offset + size * torch.sin(phase)
    return rows
