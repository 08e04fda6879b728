"""Restarts: how long to wait before an engine process is started in place of one that was lost."""

from __future__ import annotations

from collections import deque

LOSSES = 3
LOSSES_WITHIN_S = 60.0
"""So many losses within so many seconds are no accident: then the engine counts as failed, and rests."""
REST_S = 30.0
"""Before a failed engine process is tried once more, if others have kept the server alive."""
BACK_OFF_S = 0.5
"""Before an engine process is started that was lost twice within that time."""


class Restarts:
    """Counts losses. The first is made good at once, the next after a while, and more than that only after a rest."""

    def __init__(self, rest_s: float = REST_S) -> None:
        self._rest_s = rest_s
        self._losses: deque[float] = deque(maxlen=LOSSES)
        self.count = 0

    def lose(self, now: float) -> float:
        """Note a loss at a time in monotonic seconds; returns the seconds to wait."""
        self._losses.append(now)
        self.count += 1
        recent = self._recent(now)
        return self._rest_s if recent >= LOSSES else BACK_OFF_S if recent > 1 else 0.0

    def has_failed(self, now: float) -> bool:
        """Whether it was lost so often that it counts as failed."""
        return self._recent(now) >= LOSSES

    def _recent(self, now: float) -> int:
        return sum(now - at < LOSSES_WITHIN_S for at in self._losses)
