"""RequestParts: a client's message, walked over and taken apart before anything of it is parsed.

Parsed messages take many times the memory of their bytes: two bytes on the wire are an event of more than a hundred. So
a long message is counted first, and parsed a few events at a time, each part a message of its own.
"""

from __future__ import annotations

from collections.abc import Iterator

from google.protobuf.message import DecodeError

from motiongen.v1 import service_pb2

SMALL_BYTES = 4096
"""Messages up to this size are parsed as a whole."""
EVENTS_A_PART = 64
_EVENTS_TAG = 1 << 3 | 2
_FIXED_BYTES = {1: 8, 5: 4}


class Malformed(ValueError):
    """What came is no message."""


class RequestParts:
    """`walk` until `is_done`, then `control` and `events` can be asked for."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0
        self._num_events = 0
        self._control: list[bytes] = []
        self._events_from: int | None = None  # of the part that is being walked over
        self._cuts: list[tuple[int, int]] = []

    @property
    def is_done(self) -> bool:
        """Whether all of it was walked over."""
        return self._at == len(self._data)

    def walk(self, most: int) -> int:
        """Walk over so many more of the events; returns how many those were. Raises Malformed."""
        data, count = self._data, 0
        while count < most and self._at < len(data):
            begin = self._at
            tag, at = self._varint(begin)
            end = self._end_of_field(tag, at)
            if tag == _EVENTS_TAG:
                if self._events_from is None:
                    self._events_from = begin
                count += 1
                self._num_events += 1
                if self._num_events % EVENTS_A_PART == 0:
                    self._cut(end)
            else:
                self._cut(begin)
                self._control.append(data[begin:end])
            self._at = end
        if self._at == len(data):
            self._cut(self._at)
        return count

    def _cut(self, end: int) -> None:
        if self._events_from is not None:
            self._cuts.append((self._events_from, end))
            self._events_from = None

    def _end_of_field(self, tag: int, at: int) -> int:
        wire_type = tag & 7
        if wire_type == 0:
            _, end = self._varint(at)
        elif wire_type == 2:
            length, begin = self._varint(at)
            end = begin + length
        elif wire_type in _FIXED_BYTES:
            end = at + _FIXED_BYTES[wire_type]
        else:
            raise Malformed(f"wire type {wire_type} at byte {at}")
        if end > len(self._data):
            raise Malformed(f"a field at byte {at} ends beyond the message")
        return end

    def _varint(self, at: int) -> tuple[int, int]:
        """The number that begins at a byte, and where it ends."""
        data, value, shift = self._data, 0, 0
        while at < len(data):
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value, at
            shift += 7
            if shift > 63:
                break
        raise Malformed(f"a number before byte {at} does not end")

    def control(self) -> service_pb2.StreamMotionRequest:
        """The message without its events. Raises Malformed."""
        return parsed(b"".join(self._control))

    def events(self) -> Iterator[service_pb2.StreamMotionRequest]:
        """The events in order, some to a message. Raises Malformed."""
        for begin, end in self._cuts:
            yield parsed(self._data[begin:end])


def parsed(data: bytes) -> service_pb2.StreamMotionRequest:
    """Raises Malformed."""
    try:
        return service_pb2.StreamMotionRequest.FromString(data)
    except DecodeError as error:
        raise Malformed(str(error)) from error
