"""Extends corrections known at some frames to smooth curves over all frames, zero far from the known ones."""

from __future__ import annotations

import torch
from torch import Tensor

# The greatest second derivative of `smooth_step` over one unit of time; a correction of d metres that fades over T
# seconds accelerates by at most this many times d / T^2.
PEAK_ACCELERATION = 5.7735


def smooth_step(value: Tensor) -> Tensor:
    """From 0 to 1 over 0..1, with zero speed and acceleration at both ends; constant outside."""
    x = value.clamp(0, 1)
    return x * x * x * (x * (6 * x - 15) + 10)


def gaps(known: Tensor) -> tuple[Tensor, Tensor]:
    """For known (B, T, C) bool: the nearest known frames (B, T, C) before and after each frame, itself included.

    If there is none, the numbers are far outside: -10 T and 11 T.
    """
    num_frames = known.shape[1]
    frames = torch.arange(num_frames, device=known.device)[None, :, None]
    before = torch.where(known, frames, -10 * num_frames).cummax(dim=1).values
    after = torch.where(known, frames, 11 * num_frames).flip(1).cummin(dim=1).values.flip(1)
    return before, after


def spread(values: Tensor, known: Tensor, reach: int) -> Tensor:
    """Values (B, T, C, k), valid where known (B, T, C), extended to all frames.

    Between two known frames at most `reach` apart they are interpolated; elsewhere they fade to zero over `reach`
    frames. Values at known frames stay exactly the same.
    """
    num_frames = known.shape[1]
    frames = torch.arange(num_frames, device=known.device)[None, :, None]
    before, after = gaps(known)
    span = (after - before).clamp(1, reach)
    away = torch.stack([frames - before, after - frames]).to(values.dtype)
    weight_before, weight_after = smooth_step(1 - away / span)
    weight_after = weight_after * ~known
    index = torch.cat([before, after], dim=1).clamp(0, num_frames - 1)
    taken = values.gather(1, index[..., None].expand(*index.shape, values.shape[-1]))
    return weight_before[..., None] * taken[:, :num_frames] + weight_after[..., None] * taken[:, num_frames:]


def held(values: Tensor, known: Tensor) -> Tensor:
    """Values (B, T, C, k) of the latest known frame up to each frame; zero before the first."""
    before, _ = gaps(known)
    index = before.clamp(min=0)[..., None].expand(*before.shape, values.shape[-1])
    return values.gather(1, index) * (before >= 0)[..., None]


def within(frames: Tensor, reach: int) -> Tensor:
    """Whether (B, T, C) a marked frame lies at most `reach` frames away."""
    here = torch.arange(frames.shape[1], device=frames.device)[None, :, None]
    before, after = gaps(frames)
    return (here - before <= reach) | (after - here <= reach)
