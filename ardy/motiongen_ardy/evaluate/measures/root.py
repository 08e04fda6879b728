"""The root over the ground: speeds, directions, and differences of angles."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

MOVING_M_S = 0.3
RUNNING_M_S = 1.8


def ground_velocity(root: Tensor, fps: int) -> Tensor:
    """(T-1, 2) metres a second between neighbouring frames of a root (T, 2)."""
    return (root[1:] - root[:-1]) * fps


def smoothed(values: Tensor, width: int) -> Tensor:
    """Moving averages (T, K) over `width` (odd) frames of (T, K); the end values are repeated beyond the ends."""
    padded = functional.pad(values.T[None], (width // 2, width // 2), mode="replicate")
    return functional.avg_pool1d(padded, width, stride=1)[0].T


def ground_speed(root: Tensor, fps: int, width: int = 9) -> Tensor:
    """(T-1) metres a second, from a velocity smoothed over `width` frames so that a stride's sway does not count."""
    return smoothed(ground_velocity(root, fps), width).norm(dim=-1)


def turned(angle: Tensor | float, by: Tensor | float) -> Tensor:
    """The difference of angles in radians, wrapped to -pi .. pi."""
    difference = torch.as_tensor(angle) - torch.as_tensor(by)
    return torch.atan2(difference.sin(), difference.cos())


def turn_rate(heading: Tensor, fps: int, width: int = 9) -> Tensor:
    """(T-1) radians a second, smoothed, of headings (T)."""
    return smoothed((turned(heading[1:], heading[:-1]) * fps)[:, None], width)[:, 0]


def travel_angle(root: Tensor, frames: int = 8) -> float:
    """The direction, in radians about +Y, of the last frames of a root (T, 2)."""
    step = root[-1] - root[max(0, len(root) - 1 - frames)]
    return math.atan2(float(step[0]), float(step[1]))


def is_running(root: Tensor, fps: int) -> bool:
    """Whether a root is faster than 1.8 m/s on average while it moves."""
    speed = ground_velocity(root, fps).norm(dim=-1)
    moving = speed > MOVING_M_S
    return bool(moving.any()) and float(speed[moving].mean()) > RUNNING_M_S


def is_moving(root: Tensor, fps: int) -> bool:
    """Whether a clip's root is faster than 0.3 m/s on average."""
    return len(root) > 1 and float(ground_velocity(root, fps).norm(dim=-1).mean()) > MOVING_M_S
