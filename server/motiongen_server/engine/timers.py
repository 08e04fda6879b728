"""Timers: when to look at which session again, though nothing has come for it."""

from __future__ import annotations

import heapq
import itertools
import math

from motiongen_server.engine.types import SessionKey

# A later wake-up than the one that stands is not noted: the session is looked at early, and asks again.
_SLACK = 2
_LEAST_ROOM = 64


class Timers:
    """At most one wake-up of each session, the earliest it asked for. Holds a bounded multiple of the sessions."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, SessionKey]] = []
        self._order = itertools.count()
        self._at: dict[SessionKey, float] = {}

    def __len__(self) -> int:
        """Entries held, those that have been overtaken among them."""
        return len(self._heap)

    def ask(self, session: SessionKey, at: float) -> None:
        """Wake a session at this time, unless it is woken before. Infinity asks for nothing."""
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
        """The sessions whose time has come, each once; they are woken no more until they ask again."""
        woken = []
        while self._heap and self._heap[0][0] <= now:
            at, _, session = heapq.heappop(self._heap)
            if self._at.get(session) == at:
                del self._at[session]
                woken.append(session)
        return woken

    def next_at(self) -> float:
        """When the next session may have to be woken; infinity where none has."""
        return self._heap[0][0] if self._heap else math.inf
