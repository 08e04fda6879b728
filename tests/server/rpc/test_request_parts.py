"""Long messages are counted and taken apart before anything of them is parsed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.rpc.request_parts import (
    EVENTS_A_PART,
    FIELDS_A_PART,
    MOST_CONTROL_FIELDS,
    SMALL_EVENT_BYTES,
    RequestParts,
)
from motiongen_server.rpc.wire_fields import CLIP, EVENT, Malformed, num_fields, varint

MOST = 500
"""The most fields that an event may have."""

HELLO = service_pb2.ClientHello(client_agent="someone")
KNOWN = st.builds(
    lambda handle, frame: session_pb2.SessionEvent(session=handle, playhead=session_pb2.Playhead(frame=frame)),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**64 - 1),
)
UNKNOWN = st.sampled_from([b"\xf8\x01\x05", b"\xf9\x01" + bytes(8), b"\xfa\x01\x02ab", b"\xfd\x01" + bytes(4)])
"""Fields of a later version: a number, 8 bytes, a string, 4 bytes."""


def walked(data: bytes, most: int = 10) -> tuple[RequestParts, int]:
    parts, count = RequestParts(data, MOST), 0
    while not parts.is_done:
        count += parts.walk(most)
    return parts, count


@given(st.lists(KNOWN, max_size=200), UNKNOWN, st.booleans())
def test_parts_together_equal_the_message(
    events: list[session_pb2.SessionEvent], unknown: bytes, hello_first: bool
) -> None:
    whole = service_pb2.StreamMotionRequest(events=events)
    said = service_pb2.StreamMotionRequest(hello=HELLO).SerializeToString()
    data = whole.SerializeToString()
    parts, count = walked(said + unknown + data if hello_first else data + unknown + said)
    assert count == len(events)
    assert parts.control().hello == HELLO
    assert not parts.control().events
    assert not any(is_overgrown for _, is_overgrown in parts.events())
    given_back = [part for part, _ in parts.events()]
    assert [event for part in given_back for event in part.events] == events
    assert all(len(part.events) <= EVENTS_A_PART for part in given_back)


def sizes_of(events: list[session_pb2.SessionEvent], **control: object) -> list[int]:
    """How many events there are in each part of their message."""
    parts, _ = walked(service_pb2.StreamMotionRequest(events=events, **control).SerializeToString())  # type: ignore[arg-type]
    return [len(part.events) for part, _ in parts.events()]


def test_parts_are_full_except_the_last_and_hold_nothing_but_events() -> None:
    playhead = session_pb2.SessionEvent(session=7, playhead=session_pb2.Playhead(frame=5))
    assert sizes_of([playhead] * (3 * EVENTS_A_PART + 8)) == [EVENTS_A_PART] * 3 + [8]
    whole = service_pb2.StreamMotionRequest(events=[playhead] * 5).SerializeToString()
    parts, _ = walked(whole + service_pb2.StreamMotionRequest(hello=HELLO).SerializeToString() + whole)
    assert [part.WhichOneof("stream_event") for part, _ in parts.events()] == [None, None]


def test_walk_stops_after_the_number_of_fields_asked_for() -> None:
    parts = RequestParts(b"\x0a\x00" * 1000, MOST)
    assert parts.walk(300) == 300
    assert not parts.is_done
    assert parts.walk(10_000) == 700
    assert parts.is_done


@given(st.binary(min_size=1, max_size=300))
def test_random_bytes_are_malformed_or_read_as_protobuf_reads_them(data: bytes) -> None:
    try:
        parts, _ = walked(data)
        found = [event for part, _ in parts.events() for event in part.events]
        control = parts.control()
    except Malformed:
        return
    expected = service_pb2.StreamMotionRequest.FromString(data)
    assert list(expected.events) == found
    assert expected.WhichOneof("stream_event") == control.WhichOneof("stream_event")


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"\x0a\x05ab", "a field at byte 2 ends beyond the message"),
        (b"\x0d\x00", "a field at byte 1 ends beyond the message"),
        (b"\x0a", "a number before byte 1 does not end"),
        (b"\xf8\x81", "a number before byte 2 does not end"),
    ],
    ids=["text", "four bytes", "no length", "half a tag"],
)
def test_message_that_ends_within_a_field_is_malformed(data: bytes, what: str) -> None:
    with pytest.raises(Malformed, match=what):
        walked(data)


def test_unterminated_number_is_read_for_ten_bytes_at_most() -> None:
    """Else a megabyte of it would be put together a byte at a time."""
    assert varint(b"\xff" * 9 + b"\x01", 0) == (2**64 - 1, 10)
    with pytest.raises(Malformed, match="before byte 10 "):
        varint(b"\xff" * 10 + b"\x01", 0)


def test_groups_are_malformed() -> None:
    with pytest.raises(Malformed, match="wire type 3 at byte 1"):
        walked(b"\x0b\x0c\x0a\x00")  # a whole group, and an event


def test_tag_of_more_than_ten_bytes_is_malformed_wherever_the_message_ends() -> None:
    with pytest.raises(Malformed, match="a number before byte 10 does not end"):
        walked(b"\xff" * 10 + b"\x01\x00")


def edit(num_constraints: int, sequence: int = 2) -> session_pb2.SessionEvent:
    """An event with this many constraints; each is a field that has two more."""
    waypoint = motion_pb2.Constraint(frame=9, waypoint=motion_pb2.Waypoint(x=1, z=2))
    change = session_pb2.EditConstraints(upsert=[waypoint] * num_constraints)
    return session_pb2.SessionEvent(session=7, event_seq=sequence, edit_constraints=change)


def test_event_with_too_many_fields_is_marked_and_its_content_is_not_read() -> None:
    fits, too_many = edit((MOST - 10) // 3), edit(MOST // 3 + 1, 3)
    after = session_pb2.SessionEvent(session=8, event_seq=4, close=session_pb2.CloseSession())
    parts, _ = walked(service_pb2.StreamMotionRequest(events=[fits, too_many, after]).SerializeToString())
    (first, is_first_over), (second, is_second_over), (third, _) = parts.events()
    assert (list(first.events), is_first_over) == ([fits], False)
    shell = session_pb2.SessionEvent(session=7, event_seq=3, edit_constraints=session_pb2.EditConstraints())
    assert (list(second.events), is_second_over) == ([shell], True)
    assert list(third.events) == [after]


def test_counting_of_an_event_stops_at_its_field_limit() -> None:
    event = edit(100_000).SerializeToString()
    _, count = walked(service_pb2.StreamMotionRequest.FromString(b"").SerializeToString() + wrapped(event))
    assert count == 1 + (MOST + 1) // 32


def wrapped(event: bytes) -> bytes:
    """A message of one event."""
    length, written = len(event), bytearray(b"\x0a")
    while length > 0x7F:
        written.append(length & 0x7F | 0x80)
        length >>= 7
    return bytes(written) + bytes([length]) + event


def test_no_part_has_more_fields_than_are_parsed_at_once() -> None:
    many = [edit(MOST // 3 - 10, number) for number in range(60)]
    parts, _ = walked(service_pb2.StreamMotionRequest(events=many).SerializeToString())
    sizes = [len(part.events) for part, _ in parts.events()]
    assert sum(sizes) == len(many)
    assert max(sizes) * (MOST - 40) <= FIELDS_A_PART
    small = session_pb2.SessionEvent(
        edit_constraints=session_pb2.EditConstraints(upsert=[motion_pb2.Constraint()] * 400)
    )
    assert SMALL_EVENT_BYTES // 2 < small.ByteSize() < SMALL_EVENT_BYTES
    assert sizes_of([small] * 100) == [FIELDS_A_PART // (small.ByteSize() // 2)] * 10


def test_field_limit_of_an_event_depends_on_its_size() -> None:
    small = b"\x6a\x00" * (SMALL_EVENT_BYTES // 2)
    assert len(small) == SMALL_EVENT_BYTES > 2 * MOST
    ((part, is_overgrown),) = walked(wrapped(small))[0].events()
    assert (list(part.events), is_overgrown) == ([session_pb2.SessionEvent.FromString(small)], False)
    full = edit((MOST - 2) // 3, 0).SerializeToString()
    assert num_fields(full, 0, len(full), EVENT, MOST) == MOST
    ((_, is_overgrown),) = walked(wrapped(full))[0].events()
    assert not is_overgrown
    ((_, is_overgrown),) = walked(wrapped(full + b"\x08\x07"))[0].events()
    assert is_overgrown


def test_fields_of_a_clip_are_counted_at_every_level() -> None:
    opening = session_pb2.OpenSession(constraints=[motion_pb2.Constraint(waypoint=motion_pb2.Waypoint(x=1))] * 9)
    data = service_pb2.GenerateClipRequest(frame_count=40, open=opening).SerializeToString()
    assert num_fields(data, 0, len(data), CLIP, MOST) == 2 + 9 * 2


def test_control_fields_of_a_message_are_limited() -> None:
    said = service_pb2.StreamMotionRequest(hello=HELLO).SerializeToString()
    parts, count = walked(said * MOST_CONTROL_FIELDS)
    assert (parts.control().hello, count) == (HELLO, 0)


@pytest.mark.parametrize(
    "data",
    [
        b"\x12\x00" * (MOST_CONTROL_FIELDS + 1),
        wrapped(b"\x6a\x00" * (MOST + 100)),
        wrapped(b"\x6a\x05\x0a\x7f" + bytes(1100)),
        wrapped(edit(MOST // 3 + 1).SerializeToString() + b"\x00\x00"),
    ],
    ids=["control fields", "kinds of one event", "a field beyond its event", "a field of no number"],
)
def test_messages_that_no_client_sends_are_malformed(data: bytes) -> None:
    with pytest.raises(Malformed):
        list(walked(data)[0].events())
