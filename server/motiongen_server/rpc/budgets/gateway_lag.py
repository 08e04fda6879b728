"""GatewayLag: how long what is to be read and written waits for the event loop that does it."""

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
"""A message waits so long several times on its way. Pauses of a quota are shorter, on the median."""
LEAST_WRITES_HZ = 1000.0
"""Fewer messages fill no core: where those wait, it is for a processor that others use."""


class Look(NamedTuple):
    """at: on the loop's clock. lag_s: how late it was then. writes: messages that were written since the last one."""

    at: float
    lag_s: float
    writes: int


class GatewayLag:
    """Looks several times a second, while there are streams. Lives on the event loop.

    An engine that has all the time in the world does not see that those who read and write for it have none: one event
    loop serves every stream, and thousands of messages a second fill it. What it has not got round to waits as timers
    of its own, or in gRPC's threads, which want the same cores: that wait is part of every write.
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
        """The median of the last second: a single pause, or many clients at one moment, is not what it tells.

        From any thread.
        """
        return statistics.median([look.lag_s for look in self._of_late] or [0.0])

    @property
    def is_too_long(self) -> bool:
        """Whether the messages of one session more would make those later that are served already."""
        writes = sum(look.writes for look in self._of_late)
        return writes > LEAST_WRITES_HZ * OVER_S and self.lag_s > MOST_LAG_S

    @property
    def _of_late(self) -> list[Look]:
        since = self._loop.time() - OVER_S
        return [look for look in tuple(self._seen) if look.at >= since]

    def begin(self) -> None:
        """There is a stream."""
        if not self._is_looking:
            self._is_looking = True
            self._look_at(self._loop.time() + LOOK_EVERY_S)

    def note_write(self, seconds: float) -> None:
        """A message was written within so many. The shortest counts: those of clients that do not read take longer."""
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
