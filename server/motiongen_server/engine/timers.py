"""Timers: when each session has to be looked at although no event came for it."""

from __future__ import annotations

import heapq
import itertools
import math

from motiongen_server.engine.types import SessionKey

# A wake-up later than the one already noted is ignored: the session is looked at early and asks again.
_SLACK = 2
_LEAST_ROOM = 64


class Timers:
    """At most one wake-up per session: the earliest that it asked for.

    Memory is bounded by a multiple of the number of sessions.
    """

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, SessionKey]] = []
        self._order = itertools.count()
        self._at: dict[SessionKey, float] = {}

    def __len__(self) -> int:
        """Entries held, including outdated ones."""
        return len(self._heap)

    def ask(self, session: SessionKey, at: float) -> None:
        """Wake a session at this time, unless an earlier wake-up is noted. Infinity asks for nothing."""
        if at == math.inf or self._at.get(session, math.inf) <= at:
            return
        self._at[session] = at
        if len(self._heap) >= _SLACK * len(self._at) + _LEAST_ROOM:
            self._heap = [(when, next(self._order), key) for key, when in self._at.items()]
            heapq.heapify(self._heap)
        else:
            heapq.heappush(self._heap, (at, next(self._order), session))

    def forget(self, session: SessionKey) -> None:
        self._at.pop(session, None)

    def due(self, now: float) -> list[SessionKey]:
        """The sessions whose time has come, each once; they are not woken again until they ask again."""
        woken = []
        while self._heap and self._heap[0][0] <= now:
            at, _, session = heapq.heappop(self._heap)
            if self._at.get(session) == at:
                del self._at[session]
                woken.append(session)
        return woken

    def next_at(self) -> float:
        """The earliest time at which a session may have to be woken; infinity if there is none."""
        return self._heap[0][0] if self._heap else math.inf
