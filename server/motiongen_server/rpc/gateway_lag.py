"""GatewayLag: how long what is to be read and written waits for the event loop that does it."""

from __future__ import annotations

import asyncio
import statistics
from collections import deque
from collections.abc import Callable

LOOK_EVERY_S = 0.1
OVER_S = 1.0
MOST_LAG_S = 0.05
"""A message waits so long several times on its way. Pauses of a quota are shorter, on the median."""


class GatewayLag:
    """Looks several times a second, while there are streams. Lives on the event loop.

    An engine that has all the time in the world does not see that those who read and write for it have none: one event
    loop serves every stream, and thousands of messages a second fill it. What it has not got round to waits as timers
    of its own, or as gRPC's events, which it takes one in each round: that wait is part of every write.
    """

    def __init__(self, is_needed: Callable[[], bool], loop: asyncio.AbstractEventLoop | None = None) -> None:
        """is_needed: whether there are streams."""
        self._is_needed = is_needed
        self._loop = loop or asyncio.get_running_loop()
        self._seen: deque[tuple[float, float]] = deque()  # when, and how late it was then
        self._is_looking = False
        self._shortest_write_s: float | None = None  # since the last look

    @property
    def lag_s(self) -> float:
        """The median of the last second: a single pause, or many clients at one moment, is not what it tells.

        From any thread.
        """
        since = self._loop.time() - OVER_S
        return statistics.median([lag_s for at, lag_s in tuple(self._seen) if at >= since] or [0.0])

    @property
    def is_too_long(self) -> bool:
        """Whether whoever comes now would make those later that are served already."""
        return self.lag_s > MOST_LAG_S

    def begin(self) -> None:
        """There is a stream."""
        if not self._is_looking:
            self._is_looking = True
            self._look_at(self._loop.time() + LOOK_EVERY_S)

    def note_write(self, seconds: float) -> None:
        """A message was written within so many. The shortest counts: those of clients that do not read take longer."""
        if self._shortest_write_s is None or seconds < self._shortest_write_s:
            self._shortest_write_s = seconds

    def _look_at(self, due: float) -> None:
        self._loop.call_at(due, self._look, due)

    def _look(self, due: float) -> None:
        now = self._loop.time()
        self._seen.append((now, max(now - due, self._shortest_write_s or 0.0)))
        self._shortest_write_s = None
        while self._seen[0][0] < now - OVER_S:
            self._seen.popleft()
        self._is_looking = self._is_needed()
        if self._is_looking:
            self._look_at(now + LOOK_EVERY_S)
