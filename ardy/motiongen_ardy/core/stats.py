"""Means and scales of features and latents: normalize, denormalize."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor, nn

from motiongen_ardy.core.problems import Problems

VARIANCE_FLOOR = 1e-5


class StatsError(Problems):
    """Raised for statistics that are missing, of the wrong length, or not finite; it lists everything that is wrong."""


class Stats(nn.Module):
    """Mean and scale of a vector; scale = sqrt(std^2 + 1e-5), evaluated in float32.

    It is a module only so that `.to(device)` moves it; it adds no tensors to a state dict. Raises StatsError.
    """

    mean: Tensor
    scale: Tensor
    std: Tensor

    def __init__(self, mean: Tensor, std: Tensor) -> None:
        super().__init__()
        mean, std = mean.float(), std.float()
        if mean.shape != std.shape or mean.dim() != 1:
            raise StatsError(f"mean has shape {tuple(mean.shape)} and std {tuple(std.shape)}; give two equal vectors")
        if not (torch.isfinite(mean).all() and torch.isfinite(std).all()):
            raise StatsError("statistics hold NaN or infinite numbers; every mean and std must be finite")
        scale = torch.sqrt(std.square() + VARIANCE_FLOOR)
        if not torch.isfinite(scale).all():  # motion would become NaN
            raise StatsError(f"a std is {float(std.abs().max()):.3g}, whose square no float32 holds; give 1e19 at most")
        self.register_buffer("mean", mean, persistent=False)
        self.register_buffer("std", std, persistent=False)
        self.register_buffer("scale", scale, persistent=False)

    @cached_property
    def on_host(self) -> Stats:
        """A copy on the CPU."""
        return Stats(self.mean.cpu(), self.std.cpu())

    @property
    def width(self) -> int:
        return int(self.mean.shape[0])

    def normalize(self, values: Tensor) -> Tensor:
        """(..., width) in natural units -> (values - mean) / scale."""
        return (values - self.mean) / self.scale

    def denormalize(self, values: Tensor) -> Tensor:
        """(..., width) normalised -> values * scale + mean."""
        return values * self.scale + self.mean

    def select(self, *ranges: tuple[int, int]) -> Stats:
        """The statistics of the entries in the given half-open ranges, in that order."""
        return Stats(
            torch.cat([self.mean[start:end] for start, end in ranges]),
            torch.cat([self.std[start:end] for start, end in ranges]),
        )
