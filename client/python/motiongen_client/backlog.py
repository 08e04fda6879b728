"""Events that wait for the server to read or answer them: the queues that hold them, and a limit on their size."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client.errors import EventRefused

MOST_WAITING_BYTES = 64 << 20
"""While more than this waits, new events are refused."""
EVENT_BYTES = 1 << 10
"""Memory for keeping an event, in addition to its own bytes; for small events, nearly all of it."""


def size_of(event: session_pb2.SessionEvent) -> int:
    """Memory for keeping an event, in bytes."""
    return event.ByteSize() + EVENT_BYTES


class Backlog:
    """How much waits in one stream. queued_bytes: size of the events that its call has not written yet.

    unanswered_bytes: size of the events of its sessions that no server has answered yet.
    """

    def __init__(self) -> None:
        self.queued_bytes = 0
        self.unanswered_bytes = 0

    @property
    def is_queue_full(self) -> bool:
        """Whether so much waits to be written that dispensable events should be left out."""
        return self.queued_bytes > MOST_WAITING_BYTES

    def refusal(self, what: str, *, is_heard: bool) -> EventRefused | None:
        """The refusal of an event if too much waits, else None. is_heard: whether a server has the session now."""
        waiting = max(self.queued_bytes, self.unanswered_bytes)
        if waiting <= MOST_WAITING_BYTES:
            return None
        until = "the server reads them" if self.is_queue_full else "the server answers them"
        until = until if is_heard else "the connection to the server is back"
        return EventRefused(
            what,
            "RESOURCE_EXHAUSTED",
            "OUTBOX_FULL",
            f"{waiting} bytes wait until {until}, counting {EVENT_BYTES} per event in addition to its size",
            allowed=f"more once at most {MOST_WAITING_BYTES} wait; send less, or try again later",
        )


class SendQueue:
    """The events that one call has not written yet, in order, and a ping, which goes with the next message."""

    def __init__(self, backlog: Backlog, max_batch_bytes: Callable[[], int]) -> None:
        """max_batch_bytes: returns how many bytes of events a message may contain at present."""
        self._backlog = backlog
        self._max_batch_bytes = max_batch_bytes
        self._events: list[session_pb2.SessionEvent] = []
        self._ping: service_pb2.Ping | None = None

    def __bool__(self) -> bool:
        return bool(self._events) or self._ping is not None

    def put(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event; it goes out with the next message."""
        self._events.append(event)
        self._backlog.queued_bytes += size_of(event)

    def put_ping(self, ping: service_pb2.Ping) -> None:
        """Send a ping with the next message, instead of an earlier one that has not gone out."""
        self._ping = ping

    def take(self) -> service_pb2.StreamMotionRequest:
        """Remove and return the next message: as many events as it may contain, and the ping."""
        most, num_bytes, num_events = self._max_batch_bytes(), 0, 0
        for event in self._events:
            num_bytes += event.ByteSize() + 8
            if num_events and num_bytes > most:
                break
            num_events += 1
        request = service_pb2.StreamMotionRequest(events=self._events[:num_events], ping=self._ping)
        self._let_go(num_events)
        self._ping = None
        return request

    def clear(self) -> None:
        """The call is over. Unanswered events will be sent again on the next."""
        self._let_go(len(self._events))
        self._ping = None

    def _let_go(self, num_events: int) -> None:
        self._backlog.queued_bytes -= sum(map(size_of, self._events[:num_events]))
        del self._events[:num_events]


class Unanswered:
    """The unanswered events of one session, by number; playheads, which get no answer, are not among them."""

    def __init__(self, backlog: Backlog) -> None:
        self._backlog = backlog
        self._events: dict[int, session_pb2.SessionEvent] = {}
        self._sizes: dict[int, int] = {}

    def __iter__(self) -> Iterator[session_pb2.SessionEvent]:
        return iter(self._events.values())

    def get(self, event_seq: int) -> session_pb2.SessionEvent | None:
        """The event of that number; None if it is not among them."""
        return self._events.get(event_seq)

    def first(self, default: int) -> int:
        """The lowest event number; default if there is no event."""
        return min(self._events, default=default)

    def add(self, event: session_pb2.SessionEvent) -> None:
        """Add an event."""
        self._events[event.event_seq] = event
        self._sizes[event.event_seq] = size = size_of(event)
        self._backlog.unanswered_bytes += size

    def pop(self, event_seq: int) -> session_pb2.SessionEvent | None:
        """Remove and return an event that was answered; None if it was not among them."""
        self._backlog.unanswered_bytes -= self._sizes.pop(event_seq, 0)
        return self._events.pop(event_seq, None)

    def take_all(self) -> list[session_pb2.SessionEvent]:
        """Remove all events and return copies to be sent under new numbers.

        They are copies because events that still wait to be written must keep their numbers.
        """
        events = []
        for event in self._events.values():
            again = session_pb2.SessionEvent()
            again.CopyFrom(event)
            events.append(again)
        self.clear()
        return events

    def clear(self) -> None:
        """Remove all events: none will be answered."""
        self._backlog.unanswered_bytes -= sum(self._sizes.values())
        self._events.clear()
        self._sizes.clear()
