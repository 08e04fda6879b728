"""NoiseAhead: makes the noise of coming windows while a device computes the present ones."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

from torch import Tensor

from motiongen_ardy.model.noise import window_noise

MOST_AHEAD = 4096
"""Windows whose noise is kept, which is 24 MB with the released model. The oldest unused noise is dropped first."""


class NoiseAhead:
    """Noise of sessions' windows. What the next window's depends on is known: the session's seed and plan number."""

    def __init__(self, num_tokens: int, width: int) -> None:
        self._shape = num_tokens, width
        self._made: OrderedDict[tuple[int, int], Tensor] = OrderedDict()
        self._lock = Lock()
        self._maker: ThreadPoolExecutor | None = None

    def of(self, seed: int, plan: int) -> Tensor:
        """(num_tokens, width): the noise of a session's plan. Plans count from 1, a rollout's windows from 0."""
        with self._lock:
            made = self._made.pop((seed, plan), None)
        return window_noise(seed, plan - 1, *self._shape) if made is None else made

    def follow(self, plans: Sequence[tuple[int, int]]) -> None:
        """Make the noise of the plans after these (seed, plan), on a separate thread."""
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
