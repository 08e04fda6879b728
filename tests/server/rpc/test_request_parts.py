"""Long messages are counted and taken apart before anything of them is parsed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.rpc.request_parts import EVENTS_A_PART, Malformed, RequestParts

HELLO = service_pb2.ClientHello(client_agent="someone")
KNOWN = st.builds(
    lambda handle, frame: session_pb2.SessionEvent(session=handle, playhead=session_pb2.Playhead(frame=frame)),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**64 - 1),
)
UNKNOWN = st.sampled_from([b"\xf8\x01\x05", b"\xf9\x01" + bytes(8), b"\xfa\x01\x02ab", b"\xfd\x01" + bytes(4)])
"""Fields of a later version: a number, 8 bytes, a string, 4 bytes."""


def walked(data: bytes, most: int = 10) -> tuple[RequestParts, int]:
    parts, count = RequestParts(data), 0
    while not parts.is_done:
        count += parts.walk(most)
    return parts, count


@given(st.lists(KNOWN, max_size=200), UNKNOWN, st.booleans())
def test_the_parts_are_the_message(events: list[session_pb2.SessionEvent], unknown: bytes, hello_first: bool) -> None:
    whole = service_pb2.StreamMotionRequest(events=events)
    said = service_pb2.StreamMotionRequest(hello=HELLO).SerializeToString()
    data = whole.SerializeToString()
    parts, count = walked(said + unknown + data if hello_first else data + unknown + said)
    assert count == len(events)
    assert parts.control().hello == HELLO
    assert not parts.control().events
    given_back = list(parts.events())
    assert [event for part in given_back for event in part.events] == events
    assert all(len(part.events) <= EVENTS_A_PART for part in given_back)


def test_no_more_is_walked_over_than_was_asked_for() -> None:
    parts = RequestParts(b"\x0a\x00" * 1000)
    assert parts.walk(300) == 300
    assert not parts.is_done
    assert parts.walk(10_000) == 700
    assert parts.is_done


@given(st.binary(min_size=1, max_size=300))
def test_garbage_is_called_that_or_read_as_protobuf_reads_it(data: bytes) -> None:
    try:
        parts, _ = walked(data)
        found = [event for part in parts.events() for event in part.events]
        control = parts.control()
    except Malformed:
        return
    expected = service_pb2.StreamMotionRequest.FromString(data)
    assert list(expected.events) == found
    assert expected.WhichOneof("stream_event") == control.WhichOneof("stream_event")


@pytest.mark.parametrize(
    "data",
    [b"\x0a\x05ab", b"\x0a", b"\x0b\x00", b"\xff" * 12, b"\x0d\x00"],
    ids=["cut", "no length", "group", "tag", "fixed"],
)
def test_what_ends_too_early_is_malformed(data: bytes) -> None:
    with pytest.raises(Malformed):
        walked(data)
