"""Means and scales of features and latents: normalize, denormalize, read and write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

VARIANCE_FLOOR = 1e-5


class StatsError(ValueError):
    """Raised for statistics that are missing, of the wrong length, or not finite."""


class Stats(nn.Module):
    """Mean and scale of a vector; scale = sqrt(std^2 + 1e-5), evaluated in float32.

    It is a module only so that `.to(device)` carries it along; it has no tensors in a state dict.
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
        self.register_buffer("mean", mean, persistent=False)
        self.register_buffer("std", std, persistent=False)
        self.register_buffer("scale", torch.sqrt(std.square() + VARIANCE_FLOOR), persistent=False)

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


def load_stats(folder: Path, width: int) -> Stats:
    """Read `mean.npy` and `std.npy` (vectors of `width` numbers) of a folder.

    Raises StatsError when a file is missing, is not such a vector, or holds numbers that are not finite.
    """
    vectors = []
    for name in ("mean.npy", "std.npy"):
        path = folder / name
        try:
            vector = np.load(path, allow_pickle=False)
        except FileNotFoundError:
            raise StatsError(f"{path} is missing; a checkpoint needs mean.npy and std.npy in {folder}") from None
        except (ValueError, OSError, EOFError) as error:
            raise StatsError(f"{path} is not a readable .npy vector: {error}") from error
        if vector.shape != (width,) or vector.dtype.kind != "f":
            raise StatsError(f"{path} is {vector.dtype} {vector.shape}; it must be {width} floating-point numbers")
        vectors.append(torch.from_numpy(vector.astype(np.float32)))
    return Stats(*vectors)


def save_stats(stats: Stats, folder: Path) -> None:
    """Write `mean.npy` and `std.npy`, float32, into a folder that is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "mean.npy", stats.mean.cpu().numpy())
    np.save(folder / "std.npy", stats.std.cpu().numpy())
