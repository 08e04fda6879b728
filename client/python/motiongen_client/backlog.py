"""What waits here until a server takes or answers it: how much that may be, and where it is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client.errors import EventRefused

MOST_WAITING_BYTES = 64 << 20
"""Of more that waits nothing new is taken on."""
EVENT_BYTES = 1 << 10
"""What keeping an event takes besides its own bytes: of small ones, nearly all."""


def size_of(event: session_pb2.SessionEvent) -> int:
    """What keeping an event takes here, bytes."""
    return event.ByteSize() + EVENT_BYTES


class Backlog:
    """Of one stream. queued_bytes: of what its call has not written, since the server does not read.

    kept_bytes: of what its sessions were told while no server heard them, until it is answered.
    """

    def __init__(self) -> None:
        self.queued_bytes = 0
        self.kept_bytes = 0

    @property
    def is_queue_full(self) -> bool:
        """Whether so much is to be written that what can be left out is to be."""
        return self.queued_bytes > MOST_WAITING_BYTES

    def refusal(self, what: str, *, is_heard: bool) -> EventRefused | None:
        """Why nothing more is taken on of a session that a server hears, or of one that none does; None: it is."""
        waiting = self.queued_bytes if is_heard else self.kept_bytes
        if waiting <= MOST_WAITING_BYTES:
            return None
        until = "the server reads them" if is_heard else "there is a line to the server again"
        return EventRefused(
            what,
            "RESOURCE_EXHAUSTED",
            "OUTBOX_FULL",
            f"{waiting} bytes wait until {until}, each event with {EVENT_BYTES} beside its own",
            allowed=f"more once they are at most {MOST_WAITING_BYTES}; tell it less, or again later",
        )


class SendQueue:
    """The events that one call has not written, in order, and the ping that goes first."""

    def __init__(self, backlog: Backlog, max_batch_bytes: Callable[[], int]) -> None:
        """max_batch_bytes: how many bytes of events a message may have at present."""
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
        """Send a ping with the next message, in place of one that has not gone out."""
        self._ping = ping

    def take(self) -> service_pb2.StreamMotionRequest:
        """As many events as one message may carry."""
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
        """The call is over: what has no answer is said again on the next."""
        self._let_go(len(self._events))
        self._ping = None

    def _let_go(self, num_events: int) -> None:
        self._backlog.queued_bytes -= sum(map(size_of, self._events[:num_events]))
        del self._events[:num_events]


class Unanswered:
    """The events of one session that the server has not answered, by number; playheads are never among them."""

    def __init__(self, backlog: Backlog) -> None:
        self._backlog = backlog
        self._events: dict[int, session_pb2.SessionEvent] = {}
        self._kept_bytes: dict[int, int] = {}  # of those that were given while no server heard the session

    def __iter__(self) -> Iterator[session_pb2.SessionEvent]:
        return iter(self._events.values())

    def get(self, event_seq: int) -> session_pb2.SessionEvent | None:
        """The event of a number; None for one that is not among them."""
        return self._events.get(event_seq)

    def first(self, default: int) -> int:
        """The lowest number; default where there is none."""
        return min(self._events, default=default)

    def add(self, event: session_pb2.SessionEvent, *, is_kept: bool = False) -> None:
        """is_kept: no server hears it yet."""
        self._events[event.event_seq] = event
        if is_kept:
            self._kept_bytes[event.event_seq] = size_of(event)
            self._backlog.kept_bytes += size_of(event)

    def pop(self, event_seq: int) -> session_pb2.SessionEvent | None:
        """The event that has been answered; None for one that was not among them."""
        self._backlog.kept_bytes -= self._kept_bytes.pop(event_seq, 0)
        return self._events.pop(event_seq, None)

    def take_all(self) -> list[tuple[session_pb2.SessionEvent, bool]]:
        """All of them, to be said by other numbers, each with whether no server heard it when it was given.

        Copies: what is still to be written of them keeps the numbers that it has.
        """
        events = []
        for number, event in self._events.items():
            again = session_pb2.SessionEvent()
            again.CopyFrom(event)
            events.append((again, number in self._kept_bytes))
        self.clear()
        return events

    def clear(self) -> None:
        """Nothing of them will be answered."""
        self._backlog.kept_bytes -= sum(self._kept_bytes.values())
        self._events.clear()
        self._kept_bytes.clear()
