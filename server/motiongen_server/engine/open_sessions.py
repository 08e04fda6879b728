"""OpenSessions: the sessions of an engine, how many of each kind, and when to look at which."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.timers import Timers
from motiongen_server.engine.types import PlayState, Priority, SessionKey


class OpenSessions:
    """A touched session is looked at in this round; `wake_up` asks for it later. Clips are not counted.

    present: how many there are of each class.
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
        """Count it among the sessions of its class."""
        if not state.spec.is_clip:
            self.present[state.spec.priority] += 1
            self.count(state, 1)

    def leave_class(self, state: SessionState) -> None:
        """Count it there no more: it is over, or of another class from now on."""
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
        """Count a session in, or out: also around a change of what it is counted by."""
        self._counts[(state.spec.priority, state.clock.state)] += change
        self._recounted = True

    def take_counts(self) -> Counter[tuple[Priority, PlayState]] | None:
        """How many there are of each class and state; None where that has not changed since this was last asked."""
        if not self._recounted:
            return None
        self._recounted = False
        return +self._counts

    # ---- when to look at which --------------------------------------------------------------------------------------

    def touch(self, state: SessionState) -> None:
        """Something has come for a session, or of it."""
        self._touched[state.key] = state

    def take_touched(self) -> list[SessionState]:
        touched, self._touched = self._touched, {}
        return list(touched.values())

    def wake_up(self, state: SessionState, at: float) -> None:
        """Have a session touched at this time; infinity: not for time alone."""
        self._wake_ups.ask(state.key, at)

    def watch_silence(self, state: SessionState, at: float) -> None:
        """Have `fallen_silent` name a session at this time."""
        self._silences.ask(state.key, at)

    def touch_due(self, now: float) -> None:
        """Touch those whose wake-up has come."""
        for key in self._wake_ups.due(now):
            self._touched[key] = self._by_key[key]

    def fallen_silent(self, now: float) -> list[SessionState]:
        """Those whose silence was to be looked at by now."""
        return [self._by_key[key] for key in self._silences.due(now)]

    @property
    def num_wake_ups(self) -> int:
        """Entries held, those that have been overtaken among them."""
        return len(self._wake_ups)

    def next_at(self) -> float:
        """When the next session may have to be looked at; infinity where none has."""
        return min(self._wake_ups.next_at(), self._silences.next_at())
