"""RequestParts: counts the events and fields of a client's message, and splits it, before any of it is parsed.

Parsed messages take many times the memory of their bytes. So the events of a long message are counted first, as are the
fields of its long events; then it is parsed a few events at a time, each part as a message of its own. An event with
more fields than allowed is never parsed in full, only its session, its number and its kind.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from google.protobuf.message import DecodeError

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.rpc.convert.wire import VARINT
from motiongen_server.rpc.wire_fields import EVENT, LENGTH, Malformed, field, num_fields

SMALL_BYTES = 4096
"""Messages up to this size are parsed as a whole."""
SMALL_EVENT_BYTES = 1024
"""Events up to this size may have as many fields as fit; these are not counted."""
TAKEN_APART = 2
"""A long message with the parts into which it is split takes this many times its bytes in memory."""
EVENTS_A_PART = 64
FIELDS_A_PART = 4096
FIELDS_AN_EVENT = 32
"""The number of fields that are counted in the time that one event takes."""
MOST_CONTROL_FIELDS = 64
"""Fields of a message other than events; this version has three, of which one is set at a time."""
_EVENTS_TAG = 1 << 3 | LENGTH


@dataclass(frozen=True, slots=True)
class Part:
    """A range of bytes to be parsed: a message with some events, or the content of one event with too many fields."""

    begin: int
    end: int
    is_overgrown: bool = False


class RequestParts:
    """Call `walk` until `is_done`, then `control` and `events`. most_fields: allowed in one event."""

    def __init__(self, data: bytes, most_fields: int) -> None:
        self._data = data
        self._most_fields = most_fields
        self._at = 0
        self._num_events = 0  # of the present part
        self._num_fields = 0
        self._control: list[bytes] = []
        self._part_from: int | None = None
        self._parts: list[Part] = []

    @property
    def is_done(self) -> bool:
        """Whether the whole message has been counted."""
        return self._at == len(self._data)

    def walk(self, most: int) -> int:
        """Count up to `most` more events, or what takes as long as these; returns how many. Raises Malformed."""
        data, count = self._data, 0
        while count < most and self._at < len(data):
            begin = self._at
            tag, content, self._at = field(data, begin)
            if tag == _EVENTS_TAG:
                count += 1 + self._walk_event(begin, content) // FIELDS_AN_EVENT
            else:
                self._cut(begin)
                self._control.append(data[begin : self._at])
                if len(self._control) > MOST_CONTROL_FIELDS:
                    raise Malformed(f"a message has more than {MOST_CONTROL_FIELDS} fields beside its events")
        if self._at == len(data):
            self._cut(self._at)
        return count

    def _walk_event(self, begin: int, content: int) -> int:
        """Add an event to the parts; returns how many of its fields were counted."""
        end = self._at
        if end - content <= SMALL_EVENT_BYTES:
            self._add(begin, (end - content) // 2)  # at most: a field takes two bytes or more
            return 0
        count = num_fields(self._data, content, end, EVENT, self._most_fields)
        if count > self._most_fields:
            self._cut(begin)
            self._parts.append(Part(content, end, is_overgrown=True))
        else:
            self._add(begin, count)
        return count

    def _add(self, begin: int, num_fields: int) -> None:
        if self._num_fields + num_fields > FIELDS_A_PART:
            self._cut(begin)
        if self._part_from is None:
            self._part_from = begin
        self._num_events += 1
        self._num_fields += num_fields
        if self._num_events == EVENTS_A_PART:
            self._cut(self._at)

    def _cut(self, end: int) -> None:
        if self._part_from is not None:
            self._parts.append(Part(self._part_from, end))
            self._part_from = None
        self._num_events = self._num_fields = 0

    def control(self) -> service_pb2.StreamMotionRequest:
        """The message without its events. Raises Malformed."""
        return parsed(b"".join(self._control))

    def events(self) -> Iterator[tuple[service_pb2.StreamMotionRequest, bool]]:
        """Messages with some of the events each, in order, and whether it is one event with too many fields.

        Such an event has only its session, its number, and its kind without content. Raises Malformed.
        """
        for part in self._parts:
            if part.is_overgrown:
                event = shell_of(self._data, part.begin, part.end, self._most_fields)
                yield service_pb2.StreamMotionRequest(events=[event]), True
            else:
                yield parsed(self._data[part.begin : part.end]), False


def shell_of(data: bytes, begin: int, end: int, most_fields: int) -> session_pb2.SessionEvent:
    """An event with empty texts and messages. Raises Malformed, also if it has too many fields itself."""
    kept, at, count = [], begin, 0
    while at < end:
        start = at
        tag, _, at = field(data, at)
        kept.append(VARINT[tag] + b"\x00" if tag & 7 == LENGTH else data[start:at])
        count += 1
        if count > most_fields:
            raise Malformed(f"an event has more than {most_fields} fields of its own")
    try:
        return session_pb2.SessionEvent.FromString(b"".join(kept))
    except DecodeError as error:
        raise Malformed(str(error)) from error


def parsed(data: bytes) -> service_pb2.StreamMotionRequest:
    """Parse a message of a stream. Raises Malformed."""
    try:
        return service_pb2.StreamMotionRequest.FromString(data)
    except DecodeError as error:
        raise Malformed(str(error)) from error
