"""Restarts: how long to wait before a lost engine process is replaced."""

from __future__ import annotations

from collections import deque

LOSSES = 3
LOSSES_WITHIN_S = 60.0
"""After `LOSSES` losses within this time the engine counts as failed, and rests."""
REST_S = 30.0
"""The rest before a failed engine process is started again, if others have kept the server alive."""
BACK_OFF_S = 0.5
"""The wait after the second loss within `LOSSES_WITHIN_S`."""


class Restarts:
    """Counts losses. The process is replaced at once after the first, then after a short wait, then after a rest."""

    def __init__(self, rest_s: float = REST_S) -> None:
        self._rest_s = rest_s
        self._losses: deque[float] = deque(maxlen=LOSSES)
        self.count = 0

    def lose(self, now: float) -> float:
        """Count a loss. now: monotonic seconds. Returns the seconds to wait before the next start."""
        self._losses.append(now)
        self.count += 1
        recent = self._recent(now)
        return self._rest_s if recent >= LOSSES else BACK_OFF_S if recent > 1 else 0.0

    def has_failed(self, now: float) -> bool:
        """Whether it was lost so often that it counts as failed."""
        return self._recent(now) >= LOSSES

    def _recent(self, now: float) -> int:
        return sum(now - at < LOSSES_WITHIN_S for at in self._losses)
