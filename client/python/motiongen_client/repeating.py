"""Repeating: sends unanswered events again, no faster than the rate limit of a session, beyond which servers refuse."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable

from motiongen.v1 import session_pb2

PERIOD_S = 0.25
"""Time between batches; longer if the server's rate limit is very low."""


class Repeating:
    """The repetition of one session's events. events: returns the unanswered ones, in order. say: sends one."""

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
        """Whether events remain to be sent again; new events must wait behind them."""
        return self._next_seq is not None

    def begin(self, per_second: float) -> None:
        """Send the first batch now. per_second: the rate limit, events per second of a session; 0: no limit.

        Half a second's worth is sent at once, then a third of the rate: reports of the playhead count too.
        """
        self._period_s = max(PERIOD_S, 3 / per_second) if per_second > 0 else PERIOD_S
        self._part = max(int(per_second / 3 * self._period_s), 1)
        self._next_seq = 0
        self._go_on(max(int(per_second / 2), 1) if per_second > 0 else None)

    def finish(self) -> None:
        """Send the rest at once, even if the server refuses some of it."""
        if self._next_seq is not None:
            self._go_on(None)

    def stop(self) -> None:
        """Stop sending: the connection is lost, or the session has ended."""
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
