"""What has no answer is said again no faster than a server lets a session speak: it refuses what is more."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable

from motiongen.v1 import session_pb2

PERIOD_S = 0.25
"""Between one part of what is said again and the next; longer where a server lets a session say next to nothing."""


class Repeating:
    """What one session has still to say again. events: all that has no answer, in order. say: tells the server one."""

    def __init__(
        self,
        events: Callable[[], Iterable[session_pb2.SessionEvent]],
        say: Callable[[session_pb2.SessionEvent], None],
    ) -> None:
        self._events = events
        self._say = say
        self._period_s, self._part = PERIOD_S, 1
        self._next_seq: int | None = None
        self._timer: asyncio.TimerHandle | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether something is still to be said: what is said now has to wait behind it."""
        return self._next_seq is not None

    def begin(self, per_second: float) -> None:
        """Say the first of them now. per_second: how many events a session may have in a second; 0: any number.

        Half as many are said at once, a third as many a second from then on: reports of the playhead count, too.
        """
        self._period_s = max(PERIOD_S, 3 / per_second) if per_second > 0 else PERIOD_S
        self._part = max(int(per_second / 3 * self._period_s), 1)
        self._next_seq = 0
        self._go_on(max(int(per_second / 2), 1) if per_second > 0 else None)

    def finish(self) -> None:
        """Say what is left at once, whatever becomes of it."""
        if self._next_seq is not None:
            self._go_on(None)

    def stop(self) -> None:
        """Say no more: the line is lost, or the session has ended."""
        self._next_seq = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _go_on(self, most: int | None) -> None:
        first = self._next_seq or 0
        left = [event for event in self._events() if event.event_seq >= first]
        self.stop()
        for event in left[:most]:
            self._say(event)
        if most is not None and len(left) > most:
            self._next_seq = left[most].event_seq
            self._timer = asyncio.get_running_loop().call_later(self._period_s, self._go_on, self._part)
