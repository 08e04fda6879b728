"""Paces: how often something may be done, and how often whoever connects to the port of operations is let in."""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Callable

CONNECTIONS_A_SECOND = 300
"""Each is one request, and each costs the event loop that streams live on."""
CONNECTIONS_OF_AN_ADDRESS = 100
"""More often than any orchestrator or Prometheus asks; who floods leaves room for others."""
MOST_ADDRESSES = 1024
"""That are remembered: who has more than that has the pace of all alone."""


class Pace:
    """So many times a second, and no more."""

    def __init__(self, times: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._last: deque[float] = deque(maxlen=times)

    def is_used_up(self) -> bool:
        """Whether it may not be done now."""
        return len(self._last) == self._last.maxlen and self._clock() - self._last[0] < 1.0

    def allows(self) -> bool:
        """Whether it may be done now, which counts as done."""
        if self.is_used_up():
            return False
        self._last.append(self._clock())
        return True


class AddressPaces:
    """So many times a second for all, of which one address has only a part."""

    def __init__(self, of_all: int, of_one: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._all = Pace(of_all, clock)
        self._of_one = of_one
        self._addresses: OrderedDict[str, Pace] = OrderedDict()  # that came last is at the end

    def allows(self, address: str) -> bool:
        """Whether it may be done now for that address. What is refused uses up nothing."""
        pace = self._addresses.get(address)
        if pace is None:
            pace = self._addresses[address] = Pace(self._of_one, self._clock)
            if len(self._addresses) > MOST_ADDRESSES:
                self._addresses.popitem(last=False)
        self._addresses.move_to_end(address)
        return not pace.is_used_up() and self._all.allows() and pace.allows()
