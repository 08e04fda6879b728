"""QuotaShare: what an engine's own calls stand for under a quota of processor time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

_OVER_S = 2.0
# Of a processor that has hardly anything to do, what others use says nothing of what sessions will make them use.
_LEAST_BUSY = 0.05
_MOST = 4.0
_GATEWAY = 1.1
_LEARNED_S = 16.0


@dataclass(frozen=True, slots=True)
class QuotaAccount:
    """cores: the quota, for each thread of an engine: 1.5 where engines of two threads have three cores.

    engines: that share it. used_s: seconds of the whole quota that everything in it has used so far; a second of three
    cores is three seconds of processor time. spent_s: of this process, seconds of all its engine's threads; one that
    keeps two of them busy for a second spends a second, which is two of processor time. So what an engine spends of a
    second is its load, as everywhere else, 1 at the most.
    """

    cores: float
    engines: int
    used_s: Callable[[], float]
    spent_s: Callable[[], float]


class QuotaShare:
    """How much of a quota goes with each second that an engine's own calls spend, by what was used of late.

    Under a quota, calls are as fast as ever until its part of a period is used up, by whoever: other engines and the
    gateway use of it too. So an engine that goes by its own clock alone sees room until the moment in which all stand
    still. factor: of the quota, so many times what its calls take of its threads; never less than they take themselves.

    Sessions that open cost the gateway more than those that play. So what is seen counts little by little, and an
    engine begins with others as busy as itself, and with a gateway that takes what it was seen to take for a crowd.
    """

    def __init__(self, account: QuotaAccount) -> None:
        self._account = account
        self._alone = 1.0 / account.cores
        self._before_s = account.used_s()
        self._used = 0.0
        self.factor = self._bounded(_GATEWAY * account.engines * self._alone)

    def update(self, elapsed_s: float, spent: float) -> None:
        """spent: of a second, what the engine's calls spent of late, looked back as far as here."""
        now_s = self._account.used_s()
        self._used += min(1.0, elapsed_s / _OVER_S) * ((now_s - self._before_s) / elapsed_s - self._used)
        self._before_s = now_s
        if spent > _LEAST_BUSY:
            self.factor += min(1.0, elapsed_s / _LEARNED_S) * (self._bounded(self._used / spent) - self.factor)

    def _bounded(self, seen: float) -> float:
        return max(self._alone, min(seen, _MOST))
