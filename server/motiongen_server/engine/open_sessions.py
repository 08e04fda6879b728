"""OpenSessions: an engine's sessions, their counts by class and state, and when each has to be looked at."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.timers import Timers
from motiongen_server.engine.types import PlayState, Priority, SessionKey


class OpenSessions:
    """Touched sessions are looked at in this round; `wake_up` schedules a later look. Clips are not counted.

    present: the number of sessions in each class.
    """

    def __init__(self) -> None:
        self._by_key: dict[SessionKey, SessionState] = {}
        self._touched: dict[SessionKey, SessionState] = {}
        self._wake_ups = Timers()
        self._silences = Timers()
        self._counts: Counter[tuple[Priority, PlayState]] = Counter()
        self._recounted = True
        self.present: Counter[Priority] = Counter()

    def __len__(self) -> int:
        return len(self._by_key)

    def __iter__(self) -> Iterator[SessionState]:
        """In the order in which they were opened."""
        return iter(self._by_key.values())

    def __getitem__(self, key: SessionKey) -> SessionState:
        return self._by_key[key]

    def get(self, key: SessionKey) -> SessionState | None:
        return self._by_key.get(key)

    # ---- coming and going -------------------------------------------------------------------------------------------

    def add(self, state: SessionState) -> None:
        self._by_key[state.key] = self._touched[state.key] = state
        self.join_class(state)

    def join_class(self, state: SessionState) -> None:
        """Count a session in its class."""
        if not state.spec.is_clip:
            self.present[state.spec.priority] += 1
            self.count(state, 1)

    def leave_class(self, state: SessionState) -> None:
        """Stop counting a session in its class, because it ends or changes its class."""
        if not state.spec.is_clip:
            self.present[state.spec.priority] -= 1
            self.count(state, -1)

    def remove(self, state: SessionState) -> None:
        del self._by_key[state.key]
        self._touched.pop(state.key, None)
        self._wake_ups.forget(state.key)
        self._silences.forget(state.key)
        self.leave_class(state)

    def count(self, state: SessionState, change: int) -> None:
        """Add `change` to the count of the session's class and play state. Called before and after either changes."""
        self._counts[(state.spec.priority, state.clock.state)] += change
        self._recounted = True

    def take_counts(self) -> Counter[tuple[Priority, PlayState]] | None:
        """The number of sessions by class and play state; None if nothing changed since the last call."""
        if not self._recounted:
            return None
        self._recounted = False
        return +self._counts

    # ---- when to look at which --------------------------------------------------------------------------------------

    def touch(self, state: SessionState) -> None:
        """Have a session looked at in this round, because something changed for it."""
        self._touched[state.key] = state

    def take_touched(self) -> list[SessionState]:
        touched, self._touched = self._touched, {}
        return list(touched.values())

    def wake_up(self, state: SessionState, at: float) -> None:
        """Have a session touched at this time; infinity: not because of time alone."""
        self._wake_ups.ask(state.key, at)

    def watch_silence(self, state: SessionState, at: float) -> None:
        """Have `fallen_silent` return a session at this time."""
        self._silences.ask(state.key, at)

    def touch_due(self, now: float) -> None:
        """Touch the sessions whose wake-up is due."""
        for key in self._wake_ups.due(now):
            self._touched[key] = self._by_key[key]

    def fallen_silent(self, now: float) -> list[SessionState]:
        """The sessions whose silence has to be checked by now."""
        return [self._by_key[key] for key in self._silences.due(now)]

    @property
    def num_wake_ups(self) -> int:
        """Entries held, including outdated ones."""
        return len(self._wake_ups)

    def next_at(self) -> float:
        """The earliest time at which a session may have to be looked at; infinity if there is none."""
        return min(self._wake_ups.next_at(), self._silences.next_at())
