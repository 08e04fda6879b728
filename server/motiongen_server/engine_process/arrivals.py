"""Arrivals: restores an order that the engine can process for what arrives on two sockets."""

from __future__ import annotations

from motiongen_server.engine.types import Event, Open, SessionKey
from motiongen_server.engine_process.messages import CloseAhead, Events


class Arrivals:
    """A Close may arrive before events that were sent earlier, and even before its session's Open.

    The events that it has overtaken are then dropped (the gateway answers them when it learns that the session has
    closed), and an Open that arrives later is followed by the Close at once. The numbers of events distinguish a
    session from a later one with the same key.
    """

    def __init__(self) -> None:
        self._seen = 0  # the number of the last event that arrived
        self._early: dict[SessionKey, CloseAhead] = {}  # Closes whose session's Open has not arrived
        self._void: dict[SessionKey, int] = {}  # events of the session up to this number are dropped

    def ahead(self, message: CloseAhead) -> list[Event]:
        """What to pass to the engine now that a Close has arrived."""
        if message.opened > self._seen:
            self._early[message.close.session] = message
            return []
        return self._end(message)

    def in_order(self, message: Events) -> list[Event]:
        """What to pass to the engine now that these events have arrived."""
        taken: list[Event] = []
        for number, event in enumerate(message.events, message.first_number):
            self._seen = number
            key = event.session
            if self._void and number <= self._void.get(key, 0):
                continue
            taken.append(event)
            if self._early and isinstance(event, Open) and key in self._early:
                taken += self._end(self._early.pop(key))
        if self._void:
            self._void = {key: last for key, last in self._void.items() if last > self._seen}
        return taken

    def _end(self, message: CloseAhead) -> list[Event]:
        if message.last > self._seen:
            self._void[message.close.session] = message.last
        return [message.close]
