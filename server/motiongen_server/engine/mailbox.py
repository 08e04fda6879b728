"""Mailbox: the thread-safe queue of events for the engine."""

from __future__ import annotations

import threading
from collections import Counter

from motiongen_server.engine.types import Close, Event, Open, Outcome, Playhead, Resume, SessionKey
from motiongen_server.engine.types.refusals import too_many_pending


class Mailbox:
    """Events in order of arrival, put by any thread and taken all at once by the engine's thread.

    A newer Playhead replaces an older one of the same session, so a client that reports often cannot fill the mailbox.
    Other events are never dropped, but only max_pending_events of a session may wait. Close and Resume are always
    taken.
    """

    def __init__(self, max_pending_events: int) -> None:
        self._max_pending = max_pending_events
        self._lock = threading.Lock()
        self._arrived = threading.Condition(self._lock)
        self._asleep = False  # the engine sleeps and was not notified yet; notifying costs as much as the rest of `put`
        self._events: list[Event] = []
        self._playhead_at: dict[SessionKey, int] = {}
        self._waiting: Counter[SessionKey] = Counter()
        self._rung = False

    def __len__(self) -> int:
        """Events that wait."""
        return len(self._events)

    def put(self, event: Event) -> bool:
        """Hand in an event. False: not taken, since the session has as many waiting as it may."""
        key = event.session
        with self._lock:
            if isinstance(event, Playhead):
                index = self._playhead_at.setdefault(key, len(self._events))
                if index < len(self._events):
                    held = self._events[index]
                    if not isinstance(held, Playhead) or event.frame >= held.frame:  # a playhead never goes back
                        self._events[index] = event
                    return True
            else:
                if self._waiting[key] >= self._max_pending and not isinstance(event, Close | Resume):
                    return False
                self._waiting[key] += 1
                if isinstance(event, Open):
                    # A playhead of the new session must not replace one of the old session with the same key.
                    self._playhead_at.pop(key, None)
            self._events.append(event)
            if self._asleep:
                self._wake()
            return True

    def take_all(self) -> list[Event]:
        """All waiting events, oldest first."""
        with self._lock:
            events, self._events = self._events, []
            self._playhead_at.clear()
            self._waiting.clear()
            self._rung = False
            return events

    def ring(self) -> None:
        """End the current or the next `wait` without an event."""
        with self._lock:
            self._rung = True
            self._wake()

    def wait(self, timeout_s: float) -> None:
        """Sleep until an event arrives, `ring` is called, or timeout_s has passed."""
        with self._lock:
            self._arrived.wait_for(self._has_come, timeout_s)
            self._asleep = False

    def _has_come(self) -> bool:
        self._asleep = not self._events and not self._rung
        return not self._asleep

    def _wake(self) -> None:
        self._asleep = False
        self._arrived.notify()


def pending_refusal(event: Event, max_pending_events: int) -> Outcome:
    """The answer to an event that `put` did not take."""
    return too_many_pending("events", max_pending_events).outcome(event.session, event.event_seq)
