"""Arrivals: what comes to the engine on two ways, put back into an order that it can take."""

from __future__ import annotations

from motiongen_server.engine.types import Event, Open, SessionKey
from motiongen_server.engine_process.messages import CloseAhead, Events


class Arrivals:
    """A close may come ahead of events that were sent before it, and even of its session's Open.

    Then the events that it has overtaken are left out (the gateway answers them when it hears that the session has
    closed), and an Open that is still to come is followed by the close at once. The numbers of the events tell a
    session from a later one with the same key.
    """

    def __init__(self) -> None:
        self._seen = 0  # the number of the last event that came
        self._early: dict[SessionKey, CloseAhead] = {}  # closes whose session has not come yet
        self._void: dict[SessionKey, int] = {}  # events of the session up to this number are left out

    def ahead(self, message: CloseAhead) -> list[Event]:
        """What the engine is to take now that a close has come."""
        if message.opened > self._seen:
            self._early[message.close.session] = message
            return []
        return self._end(message)

    def in_order(self, message: Events) -> list[Event]:
        """What the engine is to take now that these events have come."""
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
