"""What goes wrong over time: leaning, floating, freezing."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from motiongen_ardy.core.skeleton import Skeleton

STILL_M_S = 0.02


def lean(skeleton: Skeleton, positions: Tensor) -> Tensor:
    """(T) degrees between the line from hips to neck and the vertical."""
    trunk = positions[:, skeleton.index("Neck")] - positions[:, 0]
    upright = trunk[:, 1] / trunk.norm(dim=-1)
    return torch.rad2deg(torch.acos(upright.clamp(-1, 1)))


def over_seconds(values: Tensor, fps: int, seconds: int = 1) -> Tensor:
    """(S) means of values (T) over consecutive stretches of `seconds`; an incomplete one at the end is dropped."""
    count = len(values) // (fps * seconds)
    return values[: count * fps * seconds].view(count, -1).mean(dim=-1)


def frozen_share(positions: Tensor, fps: int) -> float:
    """The share of seconds in which joints are slower than 2 cm/s on average; nan for less than one second."""
    speeds = (positions[1:] - positions[:-1]).norm(dim=-1).mean(dim=-1) * fps
    seconds = over_seconds(speeds, fps)
    return float((seconds < STILL_M_S).float().mean()) if len(seconds) else math.nan
