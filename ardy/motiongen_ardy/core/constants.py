"""Small tables of numbers that a computation needs on its device, copied there once.

A copy from the host waits for the device, and cannot be part of a captured CUDA graph; a table that is already there
costs nothing.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

Numbers = tuple[float, ...] | tuple[int, ...] | tuple[tuple[float, ...], ...]


# Graphs read tables where they are, so none may go that one was recorded with. On a GPU they follow skeletons and
# options, and there are some dozens; on a processor also which joints a seam touches.
MOST_TABLES = 4096


@lru_cache(maxsize=MOST_TABLES)
def constant(numbers: Numbers, dtype: torch.dtype, device: torch.device) -> Tensor:
    """The tensor of `numbers`; the same one at every call, so it must not be written to."""
    with torch.inference_mode(False):  # a table first used while serving may be used in training later
        return torch.tensor(numbers, dtype=dtype, device=device)


def index(numbers: tuple[int, ...], device: torch.device) -> Tensor:
    """Whole numbers to select with, on a device."""
    return constant(numbers, torch.int64, device)
