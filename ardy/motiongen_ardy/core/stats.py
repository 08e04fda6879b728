"""Means and scales of features and latents: normalize, denormalize, read and write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from motiongen_ardy.checkpoint.files import read_bytes
from motiongen_ardy.checkpoint.npy import NpyError, read_npy
from motiongen_ardy.core.problems import Problems

VARIANCE_FLOOR = 1e-5
MAX_STATS_BYTES = 1 << 20


class StatsError(Problems):
    """Raised for statistics that are missing, of the wrong length, or not finite; it lists everything that is wrong."""


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

    Raises StatsError listing what is wrong: a file missing or not such a vector, numbers that are not finite, a
    negative standard deviation, or none above zero. A single zero is sound: it belongs to a number that never changed.
    """
    problems: list[str] = []
    vectors = [_load_vector(folder / name, width, problems) for name in ("mean.npy", "std.npy")]
    mean, std = vectors
    if std is not None and bool((std < 0).any()):
        problems.append(f"{folder / 'std.npy'} holds negative numbers; a standard deviation is at least 0")
    elif std is not None and not bool(std.any()):
        problems.append(f"{folder / 'std.npy'} holds nothing but zeros; these are no statistics")
    if problems or mean is None or std is None:
        raise StatsError(problems)
    return Stats(mean, std)


def _load_vector(path: Path, width: int, problems: list[str]) -> Tensor | None:
    """A float32 vector of `width` finite numbers; None, and noted, if the file holds anything else."""
    try:
        vector = read_npy(read_bytes(path, MAX_STATS_BYTES))
    except NpyError as error:
        problems.append(f"{path} is not a readable .npy vector: {error}")
        return None
    except Problems as error:
        problems += error.problems
        return None
    if vector.shape != (width,) or vector.dtype.kind != "f":
        problems.append(f"{path} is {vector.dtype} {vector.shape}; it must be {width} floating-point numbers")
        return None
    with np.errstate(over="ignore"):  # a float64 beyond float32 becomes infinite, which is what is asked next
        values = torch.from_numpy(vector.astype(np.float32))
    if not bool(torch.isfinite(values).all()):
        problems.append(f"{path} holds NaN or infinite numbers; every one must be finite")
        return None
    return values


def save_stats(stats: Stats, folder: Path) -> None:
    """Write `mean.npy` and `std.npy`, float32, into a folder that is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "mean.npy", stats.mean.cpu().numpy())
    np.save(folder / "std.npy", stats.std.cpu().numpy())
