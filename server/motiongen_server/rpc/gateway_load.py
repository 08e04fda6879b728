"""GatewayLoad: whether the event loop that reads and writes has time for more, and how long what waits for it waits."""

from __future__ import annotations

import asyncio
import statistics
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

LOOK_EVERY_S = 0.1
OVER_S = 1.0
MOST_LAG_S = 0.05
"""A message waits so long several times on its way. Pauses of a quota are shorter, on the median."""
MOST_BUSY = 0.85
"""Of a processor, by the loop's thread: the wait of each message is several times what it is at half of that."""


class Look(NamedTuple):
    """at: on the loop's clock. lag_s: how late it was then. busy: since the last one."""

    at: float
    lag_s: float
    busy: float


class GatewayLoad:
    """Looks several times a second, while there are streams. Lives on the event loop.

    An engine that has all the time in the world does not see that those who read and write for it have none: one event
    loop serves every stream, and thousands of messages a second fill it. What it has not got round to waits as timers
    of its own, or as gRPC's events, which it takes one in each round: that wait is part of every write. Medians of a
    second count, so that a single pause, or many clients at one moment, are not taken for a loop without time.
    """

    def __init__(
        self,
        is_needed: Callable[[], bool],
        loop: asyncio.AbstractEventLoop | None = None,
        used_s: Callable[[], float] = time.thread_time,
    ) -> None:
        """is_needed: whether there are streams. used_s: processor time of the loop's thread, called on it."""
        self._is_needed = is_needed
        self._loop = loop or asyncio.get_running_loop()
        self._used_s = used_s
        self._seen: deque[Look] = deque()
        self._is_looking = False
        self._before = 0.0, 0.0  # time and processor time at the last look
        self._shortest_write_s: float | None = None  # since the last look

    @property
    def lag_s(self) -> float:
        """How long what is to be read and written waits for the loop. From any thread, as the others."""
        return statistics.median([look.lag_s for look in self._of_late] or [0.0])

    @property
    def busy(self) -> float:
        """The share of a processor that the loop's thread uses."""
        return statistics.median([look.busy for look in self._of_late] or [0.0])

    @property
    def is_full(self) -> bool:
        """Whether whoever comes now would make those later that are served already."""
        return self.busy > MOST_BUSY or self.lag_s > MOST_LAG_S

    @property
    def _of_late(self) -> list[Look]:
        since = self._loop.time() - OVER_S
        return [look for look in tuple(self._seen) if look.at >= since]

    def begin(self) -> None:
        """There is a stream."""
        if not self._is_looking:
            self._is_looking = True
            self._before = self._loop.time(), self._used_s()
            self._look_later()

    def note_write(self, seconds: float) -> None:
        """A message was written within so many. The shortest counts: those of clients that do not read take longer."""
        if self._shortest_write_s is None or seconds < self._shortest_write_s:
            self._shortest_write_s = seconds

    def _look_later(self) -> None:
        due = self._before[0] + LOOK_EVERY_S
        self._loop.call_at(due, self._look, due)

    def _look(self, due: float) -> None:
        now, used_s = self._loop.time(), self._used_s()
        busy = (used_s - self._before[1]) / (now - self._before[0])
        self._seen.append(Look(now, max(now - due, self._shortest_write_s or 0.0), busy))
        self._before, self._shortest_write_s = (now, used_s), None
        while self._seen[0].at < now - OVER_S:
            self._seen.popleft()
        self._is_looking = self._is_needed()
        if self._is_looking:
            self._look_later()
