"""Reads and writes the statistics of a checkpoint folder: `mean.npy` and `std.npy`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.files import read_bytes
from motiongen_ardy.checkpoint.npy import NpyError, read_npy
from motiongen_ardy.core.files import written_whole
from motiongen_ardy.core.problems import Problems
from motiongen_ardy.core.stats import Stats, StatsError

MAX_STATS_BYTES = 1 << 20


def load_stats(folder: Path, width: int) -> Stats:
    """Read `mean.npy` and `std.npy` (vectors of `width` numbers) from a folder.

    Raises StatsError listing what is wrong: a missing file or one that is not such a vector, numbers that are not
    finite, a standard deviation that is negative or too large to be squared, or no standard deviation above zero.
    Single zeros are valid: they belong to numbers that never changed.
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
    try:
        return Stats(mean, std)
    except StatsError as error:
        raise StatsError([f"{folder}: {problem}" for problem in error.problems]) from error


def _load_vector(path: Path, width: int, problems: list[str]) -> Tensor | None:
    """A float32 vector of `width` finite numbers; None, with a problem added, if the file holds anything else."""
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
    with np.errstate(over="ignore"):  # a float64 beyond float32 becomes infinite, which is checked next
        values = torch.from_numpy(vector.astype(np.float32))
    if not bool(torch.isfinite(values).all()):
        problems.append(f"{path} holds NaN or infinite numbers; every one must be finite")
        return None
    return values


def save_stats(stats: Stats, folder: Path) -> None:
    """Write `mean.npy` and `std.npy`, float32, into a folder, which is created if necessary."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, vector in (("mean.npy", stats.mean), ("std.npy", stats.std)):
        with written_whole(folder / name) as partial, partial.open("wb") as file:
            np.save(file, vector.cpu().numpy())
