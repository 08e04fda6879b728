"""Noise of the windows to come, made while a device computes those that are there."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

from torch import Tensor

from motiongen_ardy.model.noise import window_noise

MOST_AHEAD = 4096
"""Windows whose noise is kept; of the released size, 24 MB. Those that nobody has asked for longest go first."""


class NoiseAhead:
    """Noise of sessions' windows. What follows on a window is known: its session's seed, and the next plan."""

    def __init__(self, num_tokens: int, width: int) -> None:
        self._shape = num_tokens, width
        self._made: OrderedDict[tuple[int, int], Tensor] = OrderedDict()
        self._lock = Lock()
        self._maker: ThreadPoolExecutor | None = None

    def of(self, seed: int, plan: int) -> Tensor:
        """(num_tokens, width), what a session's plan starts from. Plans count from 1, a rollout's windows from 0."""
        with self._lock:
            made = self._made.pop((seed, plan), None)
        return window_noise(seed, plan - 1, *self._shape) if made is None else made

    def follow(self, plans: Sequence[tuple[int, int]]) -> None:
        """Make what follows on plans (seed, plan), in a thread of its own."""
        if self._maker is None:
            self._maker = ThreadPoolExecutor(1, "noise")
        self._maker.submit(self._make, plans)

    def _make(self, plans: Sequence[tuple[int, int]]) -> None:
        for seed, plan in plans:
            noise = window_noise(seed, plan, *self._shape)
            with self._lock:
                self._made[seed, plan + 1] = noise
                if len(self._made) > MOST_AHEAD:
                    self._made.popitem(last=False)
