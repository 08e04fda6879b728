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
        self._refill(now)
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True

    def charge(self, amount: float, now: float) -> None:
        """Use so many tokens, whether they are there or not: what is owed must come back before `owed_s` is 0 again."""
        self._refill(now)
        self._tokens -= amount

    def owed_s(self, now: float) -> float:
        """Seconds until what was charged is paid, 0 where it is."""
        self._refill(now)
        return max(0.0, -self._tokens) / self._rate

    def is_full(self, now: float) -> bool:
        """Whether nothing was taken of late."""
        self._refill(now)
        return self._tokens >= self._rate

    def _refill(self, now: float) -> None:
        if now != self._refilled_at:  # events of one message come at the same moment
            tokens = self._tokens + (now - self._refilled_at) * self._rate
            self._tokens = tokens if tokens < self._rate else self._rate
            self._refilled_at = now

    @property
    def wait_s(self) -> float:
        """Seconds from the last `take` until one would be allowed."""
        return max(0.0, 1 - self._tokens) / self._rate
