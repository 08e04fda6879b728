"""QuotaShare: how much of a quota of processor time an engine's own calls account for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

_OVER_S = 2.0
# Below this load, what the rest of the server uses says nothing about what sessions will make it use.
_LEAST_BUSY = 0.05
_MOST = 4.0
_GATEWAY = 1.1
_LEARNED_S = 16.0


@dataclass(frozen=True, slots=True)
class QuotaAccount:
    """A quota of processor time, and what has been used of it.

    cores: the quota per thread of an engine: 1.5 if engines of two threads have three cores. engines: how many share
    it. used_s: seconds of the whole quota that all processes in it have used so far; a second of three cores is three
    seconds of processor time. spent_s: of this process, seconds of all its engine's threads; an engine that keeps two
    threads busy for a second spends one second, which is two of processor time. So what an engine spends per second is
    its load, at most 1, as everywhere else.
    """

    cores: float
    engines: int
    used_s: Callable[[], float]
    spent_s: Callable[[], float]


class QuotaShare:
    """How much of a quota is used for each second that an engine's own calls spend, judged by recent use.

    Under a quota, calls run at full speed until the quota of a period is used up, by other engines and the gateway as
    well. An engine that went by its own clock alone would therefore see room until the moment at which everything
    stops. factor: the share of the quota that goes with the engine's calls, as a multiple of their load of its threads;
    never less than what the calls themselves use.

    Opening sessions costs the gateway more than playing ones. So observations count gradually, and an engine starts
    from the assumption that the others are as busy as itself, and that the gateway takes what it was seen to take for a
    crowd.
    """

    def __init__(self, account: QuotaAccount) -> None:
        self._account = account
        self._alone = 1.0 / account.cores
        self._before_s = account.used_s()
        self._used = 0.0
        self.factor = self._bounded(_GATEWAY * account.engines * self._alone)

    def update(self, elapsed_s: float, spent: float) -> None:
        """spent: seconds that calls of the engines here spent per second lately, averaged over _OVER_S."""
        now_s = self._account.used_s()
        self._used += min(1.0, elapsed_s / _OVER_S) * ((now_s - self._before_s) / elapsed_s - self._used)
        self._before_s = now_s
        if spent > _LEAST_BUSY:
            self.factor += min(1.0, elapsed_s / _LEARNED_S) * (self._bounded(self._used / spent) - self.factor)

    def _bounded(self, seen: float) -> float:
        return max(self._alone, min(seen, _MOST))
