"""Small tables of constants on the device that computes with them, copied there once.

A copy from the host synchronises with the device and cannot be captured in a CUDA graph; reusing a table that is
already there costs nothing.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

Numbers = tuple[float, ...] | tuple[int, ...] | tuple[tuple[float, ...], ...]


# CUDA graphs read tables by address, so a table that a graph was recorded with must never be evicted. On a GPU there is
# a table per skeleton and set of options, some dozens in all; on a CPU also one per set of joints that a seam touches.
MOST_TABLES = 4096


@lru_cache(maxsize=MOST_TABLES)
def constant(numbers: Numbers, dtype: torch.dtype, device: torch.device) -> Tensor:
    """`numbers` as a tensor. Every call returns the same tensor, so it must not be written to."""
    with torch.inference_mode(False):  # a table first created while serving may later be used in training
        return torch.tensor(numbers, dtype=dtype, device=device)


def index(numbers: tuple[int, ...], device: torch.device) -> Tensor:
    """`numbers` as an int64 index tensor on a device."""
    return constant(numbers, torch.int64, device)
