"""Token bucket: a sustained rate with bursts."""

from __future__ import annotations


class TokenBucket:
    """Allows `rate` events a second over time, and as many at once as one second's worth."""

    __slots__ = ("_rate", "_refilled_at", "_tokens")

    def __init__(self, rate: float, now: float) -> None:
        self._rate = rate
        self._tokens = rate
        self._refilled_at = now

    def take(self, now: float) -> bool:
        """Use one token; false when none is left. now: monotonic seconds."""
        if now != self._refilled_at:  # events of one message come at the same moment
            tokens = self._tokens + (now - self._refilled_at) * self._rate
            self._tokens = tokens if tokens < self._rate else self._rate
            self._refilled_at = now
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True

    @property
    def wait_s(self) -> float:
        """Seconds from the last `take` until one would be allowed."""
        return max(0.0, 1 - self._tokens) / self._rate
