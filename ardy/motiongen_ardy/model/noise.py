"""The noise a window starts from: a function of (seed, window number) alone, never of a global generator."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

MAX_KEY = 1 << 64


def window_noise(seed: int, window_index: int, num_tokens: int, width: int) -> Tensor:
    """Standard normal numbers (num_tokens, width) float32, by the counter-based generator Philox (Salmon et al. 2011).

    Raises ValueError for a seed or window index outside 0 .. 2^64 - 1.
    """
    for name, value in (("seed", seed), ("window_index", window_index)):
        if not 0 <= value < MAX_KEY:
            raise ValueError(f"{name} is {value}; it must be a whole number from 0 to 2^64 - 1")
    generator = np.random.Generator(np.random.Philox(key=np.array([seed, window_index], dtype=np.uint64)))
    return torch.from_numpy(generator.standard_normal((num_tokens, width), dtype=np.float32))
