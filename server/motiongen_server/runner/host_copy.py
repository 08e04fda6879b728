"""Copies results from a device into arrays of this process."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def on_host(*tensors: Tensor) -> list[np.ndarray]:
    """Each tensor as an array that may be kept; an array of a CPU tensor shares its memory.

    Copies from a GPU go through page-locked memory, which is ten times as fast, with one wait for all of them.
    """
    device = tensors[0].device
    if device.type != "cuda":
        return [tensor.cpu().numpy() for tensor in tensors]
    locked = [torch.empty(tensor.shape, dtype=tensor.dtype, pin_memory=True) for tensor in tensors]
    for there, here in zip(tensors, locked, strict=True):
        here.copy_(there, non_blocking=True)
    torch.cuda.current_stream(device).synchronize()
    return [here.numpy().copy() for here in locked]  # page-locked memory is scarce, and frames are kept for long
