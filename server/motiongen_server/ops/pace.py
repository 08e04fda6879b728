"""Rate limits for the port of health and metrics: of connections, in all and for each address, and of renderings."""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Callable

CONNECTIONS_A_SECOND = 300
"""Each carries one request, and takes time of the event loop that serves the streams."""
CONNECTIONS_OF_AN_ADDRESS = 100
"""More than any orchestrator or Prometheus needs; an address that floods leaves room for others."""
MOST_ADDRESSES = 1024
"""Addresses that are remembered; for a client with more than that, only the limit for all addresses holds."""


class Pace:
    """Allows something at most `times` times a second."""

    def __init__(self, times: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._last: deque[float] = deque(maxlen=times)

    def is_used_up(self) -> bool:
        """Whether it is not allowed now."""
        return len(self._last) == self._last.maxlen and self._clock() - self._last[0] < 1.0

    def allows(self) -> bool:
        """Whether it is allowed now; if so, it is counted."""
        if self.is_used_up():
            return False
        self._last.append(self._clock())
        return True


class AddressPaces:
    """Allows something at most `of_all` times a second in all, and `of_one` times for one address."""

    def __init__(self, of_all: int, of_one: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._all = Pace(of_all, clock)
        self._of_one = of_one
        self._addresses: OrderedDict[str, Pace] = OrderedDict()  # the most recent address at the end

    def allows(self, address: str) -> bool:
        """Whether it is allowed now for an address; only then is it counted."""
        pace = self._addresses.get(address)
        if pace is None:
            pace = self._addresses[address] = Pace(self._of_one, self._clock)
            if len(self._addresses) > MOST_ADDRESSES:
                self._addresses.popitem(last=False)
        self._addresses.move_to_end(address)
        return not pace.is_used_up() and self._all.allows() and pace.allows()
