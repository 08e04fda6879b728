"""The immutable diffusion schedule, and a reverse step in which each row has its own step index and schedule."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

MAX_BETA = 0.999
MIN_REMAINING = 1e-9


@dataclass(frozen=True, eq=False)
class NoiseSchedule:
    """The base steps of training and the shortened schedules for sampling (Nichol and Dhariwal 2021, cosine).

    Tables are indexed [num_steps, i]; i counts a row's steps from the cleanest (0) to the noisiest (num_steps - 1).
    signal: (base steps) float32, the remaining share of the clean signal's variance at each base step.
    base_step: (n + 1, n) int64. remaining, remaining_before: (n + 1, n) float32, the signal's variance in the input and
    in the output of a reverse step.
    """

    num_base_steps: int
    signal: Tensor
    base_step: Tensor
    remaining: Tensor
    remaining_before: Tensor

    def to(self, device: torch.device | str) -> NoiseSchedule:
        """The same schedule with its tables on `device`."""
        return NoiseSchedule(
            self.num_base_steps,
            self.signal.to(device),
            self.base_step.to(device),
            self.remaining.to(device),
            self.remaining_before.to(device),
        )

    def add_noise(self, clean: Tensor, noise: Tensor, step: Tensor) -> Tensor:
        """Noisy tokens (B, N, C) at base steps (B): sqrt(A) clean + sqrt(1 - A) noise (Ho et al. 2020, eq. 4)."""
        signal = self.signal[step][:, None, None]
        return signal.sqrt() * clean + (1 - signal).sqrt() * noise

    def reverse_step(self, noisy: Tensor, clean: Tensor, index: Tensor, num_steps: Tensor) -> Tensor:
        """Move noisy tokens (B, N, C) one step towards the predicted clean ones (Song et al. 2021, eq. 12, eta 0).

        index: (B) int64, each row's step, from num_steps - 1 down to 0; num_steps: (B) int64, each row's schedule.
        At index 0 the result is `clean`.
        """
        given = self.remaining[num_steps, index][:, None, None]
        target = self.remaining_before[num_steps, index][:, None, None]
        noise = (noisy / given.sqrt() - clean) / (1 / given - 1).sqrt()
        return clean * target.sqrt() + noise * (1 - target).sqrt()


def signal_variance(num_base_steps: int) -> np.ndarray:
    """A_i, float32: the running product of 1 - beta_i of the cosine schedule, with beta capped at 0.999."""

    def level(fraction: float) -> float:
        return math.cos((fraction + 0.008) / 1.008 * math.pi / 2) ** 2

    betas = [
        min(1 - level((step + 1) / num_base_steps) / level(step / num_base_steps), MAX_BETA)
        for step in range(num_base_steps)
    ]
    return running_product(np.float32(1) - np.array(betas, dtype=np.float32))


def running_product(factors: np.ndarray) -> np.ndarray:
    """Running product of float32 factors, rounded to float32 only at the end, as in the released models."""
    return np.cumprod(factors, dtype=np.float64).astype(np.float32)


def chosen_steps(num_steps: int, num_base_steps: int) -> list[int]:
    """The base steps of a schedule of num_steps, ascending; a single step uses base step 0, as released models do."""
    stride = (num_base_steps - 1) / max(1, num_steps - 1)
    return [min(round(index * stride), num_base_steps - 1) for index in range(num_steps)]


@lru_cache
def cosine_schedule(num_base_steps: int = 10) -> NoiseSchedule:
    """The schedule of a model trained with num_base_steps. Raises ValueError if that is less than 1."""
    if num_base_steps < 1:
        raise ValueError(f"num_base_steps is {num_base_steps}; a diffusion needs at least 1 step")
    signal = signal_variance(num_base_steps)
    shape = (num_base_steps + 1, num_base_steps)
    base_step = np.zeros(shape, dtype=np.int64)
    remaining = np.ones(shape, dtype=np.float32)
    remaining_before = np.ones(shape, dtype=np.float32)
    for num_steps in range(1, num_base_steps + 1):
        steps = chosen_steps(num_steps, num_base_steps)
        kept = signal[steps]
        betas = np.float32(1) - kept / np.concatenate([np.ones(1, np.float32), kept[:-1]])
        products = np.maximum(running_product(np.float32(1) - betas), np.float32(MIN_REMAINING))
        base_step[num_steps, :num_steps] = steps
        remaining[num_steps, :num_steps] = products
        remaining_before[num_steps, 1:num_steps] = products[:-1]
    return NoiseSchedule(
        num_base_steps,
        torch.from_numpy(signal),
        torch.from_numpy(base_step),
        torch.from_numpy(remaining),
        torch.from_numpy(remaining_before),
    )
