"""LoopLag: how late the event loop is for what it was to do at a moment."""

from __future__ import annotations

import asyncio
import statistics
from collections import deque
from collections.abc import Callable

LOOK_EVERY_S = 0.1
OVER_S = 2.0
MOST_LAG_S = 0.1
"""Beyond, an edit waits longer for the gateway than for most models. Pauses of a quota are shorter."""


class LoopLag:
    """Looks several times a second, while there is something to be late for. Lives on the event loop.

    An engine that has all the time in the world does not see that those who read and write for it have none: one event
    loop serves every stream, and thousands of messages a second fill it.
    """

    def __init__(self, is_needed: Callable[[], bool], loop: asyncio.AbstractEventLoop | None = None) -> None:
        self._is_needed = is_needed
        self._loop = loop or asyncio.get_running_loop()
        self._seen: deque[tuple[float, float]] = deque()  # when, and how late that was
        self._is_looking = False

    @property
    def lag_s(self) -> float:
        """The median of the last two seconds: a single pause, or many clients at one moment, is not what it tells."""
        since = self._loop.time() - OVER_S
        return statistics.median([lag_s for at, lag_s in tuple(self._seen) if at >= since] or [0.0])

    @property
    def is_too_long(self) -> bool:
        """Whether whoever comes now would make those later that are served already."""
        return self.lag_s > MOST_LAG_S

    def begin(self) -> None:
        """There is something to be late for."""
        if not self._is_looking:
            self._is_looking = True
            self._look_at(self._loop.time() + LOOK_EVERY_S)

    def _look_at(self, due: float) -> None:
        self._loop.call_at(due, self._look, due)

    def _look(self, due: float) -> None:
        now = self._loop.time()
        self._seen.append((now, now - due))
        while self._seen[0][0] < now - OVER_S:
            self._seen.popleft()
        self._is_looking = self._is_needed()
        if self._is_looking:
            self._look_at(now + LOOK_EVERY_S)
