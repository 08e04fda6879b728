"""GatewayLag: how long messages to be read or written wait for the event loop."""

from __future__ import annotations

import asyncio
import math
import statistics
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

LOOK_EVERY_S = 0.1
OVER_S = 1.0
MOST_LAG_S = 0.05
"""A message waits this long several times on its way. The median pause that a CPU quota causes is shorter."""
LEAST_WRITES_HZ = 1000.0
"""Fewer messages do not fill a core: if they wait, it is because other programs use the processor."""


class Look(NamedTuple):
    """One measurement. at: on the loop's clock. lag_s: how late it was. writes: messages written since the last one."""

    at: float
    lag_s: float
    writes: int


class GatewayLag:
    """Measures the lag several times a second while there are streams. Lives on the event loop.

    An engine with time to spare cannot see that the event loop that reads and writes for it has none: one loop serves
    all streams, and thousands of messages a second fill it. Its backlog shows as late timers, and as longer writes:
    these include the wait for gRPC's threads, which compete for the same cores.
    """

    def __init__(self, is_needed: Callable[[], bool], loop: asyncio.AbstractEventLoop | None = None) -> None:
        """is_needed: whether there are streams."""
        self._is_needed = is_needed
        self._loop = loop or asyncio.get_running_loop()
        self._seen: deque[Look] = deque()
        self._is_looking = False
        self._writes, self._shortest_write_s = 0, math.inf  # since the last look

    @property
    def lag_s(self) -> float:
        """The median over the last second, which a single pause or a burst of clients does not change.

        May be read from any thread.
        """
        return statistics.median([look.lag_s for look in self._of_late] or [0.0])

    @property
    def is_too_long(self) -> bool:
        """Whether the messages of one more session would delay those of sessions that are already served."""
        writes = sum(look.writes for look in self._of_late)
        return writes > LEAST_WRITES_HZ * OVER_S and self.lag_s > MOST_LAG_S

    @property
    def _of_late(self) -> list[Look]:
        since = self._loop.time() - OVER_S
        return [look for look in tuple(self._seen) if look.at >= since]

    def begin(self) -> None:
        """A stream has begun: measure from now on."""
        if not self._is_looking:
            self._is_looking = True
            self._look_at(self._loop.time() + LOOK_EVERY_S)

    def note_write(self, seconds: float) -> None:
        """Note how long writing a message took. The shortest counts: writes to clients that do not read take longer."""
        self._writes += 1
        if seconds < self._shortest_write_s:
            self._shortest_write_s = seconds

    def _look_at(self, due: float) -> None:
        self._loop.call_at(due, self._look, due)

    def _look(self, due: float) -> None:
        now = self._loop.time()
        waited_s = self._shortest_write_s if self._writes else 0.0
        self._seen.append(Look(now, max(now - due, waited_s), self._writes))
        self._writes, self._shortest_write_s = 0, math.inf
        while self._seen[0].at < now - OVER_S:
            self._seen.popleft()
        self._is_looking = self._is_needed()
        if self._is_looking:
            self._look_at(now + LOOK_EVERY_S)
