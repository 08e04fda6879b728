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
        """Use tokens, whether they are there or not: `owed_s` is above 0 until the missing ones have come back."""
        self._refill(now)
        self._tokens -= amount

    def give_back(self, amount: float, now: float) -> None:
        """Refund tokens that were charged but not used."""
        self._refill(now)
        self._tokens = min(self._rate, self._tokens + amount)

    def owed_s(self, now: float) -> float:
        """Seconds until all that was charged is paid; 0 if it is."""
        if self._tokens >= 0:  # the usual case; asked for every message
            return 0.0
        self._refill(now)
        return max(0.0, -self._tokens) / self._rate

    def left(self, now: float) -> float:
        """The tokens that can be used now, 0 or more."""
        self._refill(now)
        return max(0.0, self._tokens)

    def is_full(self, now: float) -> bool:
        """Whether all that was taken has come back."""
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
        """Change the rate from now on; the burst changes with it."""
        self._refill(now)
        self._rate = rate
        self._tokens = min(self._tokens, rate)

    @property
    def wait_s(self) -> float:
        """Seconds from the last `take` until one would be allowed."""
        return max(0.0, 1 - self._tokens) / self._rate


class Bucket(Protocol):
    """A bucket that several users share: a `TokenBucket`, or a `Share` of one."""

    @property
    def rate(self) -> float:
        """Tokens that come back in a second."""

    def charge(self, amount: float, now: float) -> None:
        """Use tokens, whether they are there or not."""

    def give_back(self, amount: float, now: float) -> None:
        """Refund tokens that were charged but not used."""

    def owed_s(self, now: float) -> float:
        """Seconds until all that was charged is paid; 0 if it is."""

    def left(self, now: float) -> float:
        """The tokens that can be used now, 0 or more."""


class Share:
    """One user's share of a bucket that several use: a user who keeps to an equal share never waits for the others.

    A share begins with its part of what the bucket has left, so coming back again and again gains nothing. What is used
    while the bucket owes nothing makes no debt: a user who had much then is not behind once others come.
    """

    __slots__ = ("_bucket", "_num_users", "_refilled_at", "_tokens")

    def __init__(self, bucket: Bucket, num_users: Callable[[], int], now: float) -> None:
        """num_users: returns how many use the bucket now."""
        self._bucket = bucket
        self._num_users = num_users
        self._tokens = bucket.left(now) / max(1, num_users())
        self._refilled_at = now

    @property
    def rate(self) -> float:
        """Tokens that come back in a second."""
        return self._bucket.rate / max(1, self._num_users())

    def charge(self, amount: float, now: float) -> None:
        """Use tokens of the bucket, whether they are there or not."""
        self._refill(now)
        self._bucket.charge(amount, now)
        self._tokens -= amount
        if self._tokens < 0 and not self._bucket.owed_s(now):
            self._tokens = 0.0

    def give_back(self, amount: float, now: float) -> None:
        """Refund tokens that were charged but not used."""
        self._refill(now)
        self._bucket.give_back(amount, now)
        self._tokens = min(self.rate, self._tokens + amount)

    def left(self, now: float) -> float:
        """The tokens that can be used now, 0 or more."""
        self._refill(now)
        return max(0.0, self._tokens)

    def is_full(self, now: float) -> bool:
        """Whether all that was taken has come back."""
        self._refill(now)
        return self._tokens >= self.rate

    def owed_s(self, now: float) -> float:
        """Seconds until this user may go on: 0 while the bucket owes nothing, or the user has had only its share."""
        of_all_s = self._bucket.owed_s(now)
        return min(of_all_s, self.ahead_s(now)) if of_all_s else 0.0

    def ahead_s(self, now: float) -> float:
        """Seconds until this user has had no more than its share; 0 while the bucket owes nothing.

        Users who wait for this, and not only until the bucket is paid, do not all come back at the same moment.
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
