"""QuotaShare: what an engine's own calls stand for under a quota of processor time."""

from __future__ import annotations

from collections.abc import Callable

_OVER_S = 2.0
# Of a processor that has hardly anything to do, what others use says nothing of what sessions will make them use.
_LEAST_BUSY = 0.05
_MOST = 4.0


class QuotaShare:
    """How much of a quota goes with each second of an engine's own calls, by what was used of late.

    Under a quota, calls are as fast as ever until its part of a period is used up, by whoever: other engines and the
    gateway use of it too. So an engine that goes by its own clock alone sees room until the moment in which all stand
    still. factor: so many times what its calls take of a processor goes of the quota, at least 1.
    """

    def __init__(self, used_s: Callable[[], float]) -> None:
        """used_s: seconds of the whole quota that everything in it has used so far."""
        self._used_s = used_s
        self._before_s = used_s()
        self._used = 0.0
        self.factor = 1.0

    def update(self, elapsed_s: float, busy: float) -> None:
        """busy: the share of time that the engine's calls took of late, over as long as is looked back here."""
        now_s = self._used_s()
        self._used += min(1.0, elapsed_s / _OVER_S) * ((now_s - self._before_s) / elapsed_s - self._used)
        self._before_s = now_s
        self.factor = min(max(1.0, self._used / busy), _MOST) if busy > _LEAST_BUSY else 1.0
