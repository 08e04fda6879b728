"""Token bucket: a sustained rate with bursts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class TokenBucket:
    """Allows `rate` events a second over time, and as many at once as one second's worth."""

    __slots__ = ("_rate", "_refilled_at", "_tokens")

    def __init__(self, rate: float, now: float) -> None:
        self._rate = rate
        self._tokens = rate
        self._refilled_at = now

    def take(self, now: float) -> bool:
        """Use one token; false when none is left. now: monotonic seconds."""
        if now != self._refilled_at:
            self._refill(now)
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True

    def charge(self, amount: float, now: float) -> None:
        """Use so many tokens, whether they are there or not: what is owed must come back before `owed_s` is 0 again."""
        self._refill(now)
        self._tokens -= amount

    def give_back(self, amount: float, now: float) -> None:
        """So many tokens of those that were charged were not used."""
        self._refill(now)
        self._tokens = min(self._rate, self._tokens + amount)

    def owed_s(self, now: float) -> float:
        """Seconds until what was charged is paid, 0 where it is."""
        if self._tokens >= 0:  # as it is for most of what is asked, which comes with every message
            return 0.0
        self._refill(now)
        return max(0.0, -self._tokens) / self._rate

    def left(self, now: float) -> float:
        """What can be used at once, 0 or more."""
        self._refill(now)
        return max(0.0, self._tokens)

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
    def rate(self) -> float:
        """Tokens that come back in a second."""
        return self._rate

    def set_rate(self, rate: float, now: float) -> None:
        """Tokens come back at another rate from now on."""
        self._refill(now)
        self._rate = rate
        self._tokens = min(self._tokens, rate)

    @property
    def wait_s(self) -> float:
        """Seconds from the last `take` until one would be allowed."""
        return max(0.0, 1 - self._tokens) / self._rate


class Bucket(Protocol):
    """What several may use: a `TokenBucket`, or a `Share` of one."""

    @property
    def rate(self) -> float:
        """Tokens that come back in a second."""

    def charge(self, amount: float, now: float) -> None:
        """Use so many tokens, whether they are there or not."""

    def give_back(self, amount: float, now: float) -> None:
        """So many tokens of those that were charged were not used."""

    def owed_s(self, now: float) -> float:
        """Seconds until what was charged is paid, 0 where it is."""

    def left(self, now: float) -> float:
        """What can be used at once, 0 or more."""


class Share:
    """One user's part of a bucket that several use: who keeps to an equal part never waits for the others.

    It begins with a part of what the bucket has left: who comes again and again gets no more by that. What is used
    while the bucket owes nothing is owed to nobody, so that who had much then is not behind once others come.
    """

    __slots__ = ("_bucket", "_num_users", "_refilled_at", "_tokens")

    def __init__(self, bucket: Bucket, num_users: Callable[[], int], now: float) -> None:
        """num_users: how many use the bucket now."""
        self._bucket = bucket
        self._num_users = num_users
        self._tokens = bucket.left(now) / max(1, num_users())
        self._refilled_at = now

    @property
    def rate(self) -> float:
        """Tokens that come back in a second."""
        return self._bucket.rate / max(1, self._num_users())

    def charge(self, amount: float, now: float) -> None:
        """Use so many tokens of the bucket, whether they are there or not."""
        self._refill(now)
        self._bucket.charge(amount, now)
        self._tokens -= amount
        if self._tokens < 0 and not self._bucket.owed_s(now):
            self._tokens = 0.0

    def give_back(self, amount: float, now: float) -> None:
        """So many tokens of those that were charged were not used."""
        self._refill(now)
        self._bucket.give_back(amount, now)
        self._tokens = min(self.rate, self._tokens + amount)

    def left(self, now: float) -> float:
        """What can be used at once, 0 or more."""
        self._refill(now)
        return max(0.0, self._tokens)

    def is_full(self, now: float) -> bool:
        """Whether nothing was taken of late."""
        self._refill(now)
        return self._tokens >= self.rate

    def owed_s(self, now: float) -> float:
        """Seconds until this user may go on: 0 while the bucket owes nothing, or this one has had only its part."""
        of_all_s = self._bucket.owed_s(now)
        return min(of_all_s, self.ahead_s(now)) if of_all_s else 0.0

    def ahead_s(self, now: float) -> float:
        """Seconds until this user has had no more than its part; 0 while the bucket owes nothing.

        Who waits for that, and not only until the bucket is paid, does not come back at one moment with all others.
        """
        if not self._bucket.owed_s(now):
            return 0.0
        self._refill(now)
        return max(0.0, -self._tokens) / self.rate

    def _refill(self, now: float) -> None:
        if now != self._refilled_at:
            rate = self.rate
            self._tokens = min(rate, self._tokens + (now - self._refilled_at) * rate)
            self._refilled_at = now
