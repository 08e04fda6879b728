"""The initial noise of a window: a function of (seed, window number) alone, independent of any global generator."""

from __future__ import annotations

import threading

import numpy as np
import torch
from torch import Tensor

MAX_KEY = 1 << 64
_WORDS = np.zeros(4, np.uint64)


class _Generators(threading.local):
    """One per thread, reused: creating one asks the system for entropy, which takes longer than a window's numbers."""

    def __init__(self) -> None:
        self.philox = np.random.Philox(0)
        self.normal = np.random.Generator(self.philox)


_generators = _Generators()


def window_noise(seed: int, window_index: int, num_tokens: int, width: int) -> Tensor:
    """Standard normal numbers (num_tokens, width) float32 from the counter-based generator Philox (Salmon et al. 2011).

    Raises ValueError if seed or window index is not a whole number from 0 to 2^64 - 1.
    """
    for name, value in (("seed", seed), ("window_index", window_index)):
        if not isinstance(value, int | np.integer) or not 0 <= value < MAX_KEY:
            raise ValueError(f"{name} is {value}; it must be a whole number from 0 to 2^64 - 1")
    _generators.philox.state = {
        "bit_generator": "Philox",
        "state": {"counter": _WORDS, "key": np.array([seed, window_index], dtype=np.uint64)},
        "buffer": _WORDS,
        "buffer_pos": 4,  # empty
        "has_uint32": 0,
        "uinteger": 0,
    }
    return torch.from_numpy(_generators.normal.standard_normal((num_tokens, width), dtype=np.float32))
