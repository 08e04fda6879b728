"""Bytes that wait for a server are bounded: edits beyond the bound are refused, and those accepted before are kept."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import Edit, EventRefused, MotionClient, SessionEnded, backlog
from motiongen_client.backlog import EVENT_BYTES, Backlog, SendQueue, Unanswered
from tests.client.fake_server import FakeServer
from tests.client.waiting import received, until


@pytest.fixture(autouse=True)
def small_backlog(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backlog, "MOST_WAITING_BYTES", 4 * EVENT_BYTES)


def an_event(number: int, text: str = "") -> session_pb2.SessionEvent:
    event = session_pb2.SessionEvent(session=1, event_seq=number)
    event.edit_prompts.upsert.add(prompt_id=1, text=text)
    return event


def split_by_refusal(edits: list[Edit]) -> tuple[list[Edit], list[Edit]]:
    """The edits that were accepted, and those that were refused at once."""
    return [edit for edit in edits if not edit.done()], [edit for edit in edits if edit.done()]


async def lose_the_connection(client: MotionClient, server: FakeServer) -> None:
    """Returns before the event loop can make another connection."""
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)
    await until(lambda: not client.is_connected)


async def check_refused(edit: Edit) -> None:
    with pytest.raises(EventRefused, match=r"OUTBOX_FULL: \d+ bytes wait .* allowed is .*; send less") as refused:
        await edit
    assert refused.value.code == "RESOURCE_EXHAUSTED"
    assert edit.event_seq == 0


async def test_edits_beyond_the_backlog_are_refused_while_disconnected(
    client: MotionClient, server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    session = await client.open("a person walks")
    await lose_the_connection(client, server)
    edits = [session.set_prompt(f"prompt {number}") for number in range(12)]
    late = session.add_waypoint(1, 2, frame=900)
    taken, refused = split_by_refusal(edits)
    assert (taken, refused) == (edits[:4], edits[4:])
    for edit in (*refused, late):
        await check_refused(edit)
    assert len([each for each in caplog.records if "OUTBOX_FULL" in each.getMessage()]) == 1, "logged once for all"
    with pytest.raises(EventRefused, match="OUTBOX_FULL"):
        await session.constraint_reached(late.constraint_ids[0])
    await asyncio.gather(*taken)
    said = await received(server, "edit_prompts", 4)
    assert [each.edit_prompts.upsert[0].text for each in said] == [f"prompt {number}" for number in range(4)]
    assert (await session.set_prompt("one more")).effective_frame is not None
    await lose_the_connection(client, server)
    assert not session.set_prompt("what was answered waits no more").done()


async def test_edits_beyond_the_backlog_are_refused_while_the_server_does_not_read(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    edits = [session.set_prompt(f"prompt {number}") for number in range(12)]  # nothing is written meanwhile
    taken, refused = split_by_refusal(edits)
    assert (taken, refused) == (edits[:4], edits[4:])
    with pytest.raises(EventRefused, match="opening a session was refused with OUTBOX_FULL"):
        await client.open("another")
    for edit in refused:
        await check_refused(edit)
    await asyncio.gather(*taken)
    (outcome, last) = await asyncio.gather(session.set_prompt("what was read waits no more"), client.open("another"))
    assert outcome.effective_frame is not None
    assert last.opened.session_id


async def test_edits_beyond_the_backlog_are_refused_while_the_server_does_not_answer(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    take = server.stream.take
    server.stream.take = lambda event, refuse: None  # type: ignore[method-assign]
    taken = []
    for number in range(4):  # one by one, so that none waits to be written
        taken.append(session.set_prompt(f"prompt {number}"))
        await received(server, "edit_prompts", number + 1)
    assert split_by_refusal(taken) == (taken, [])
    refused = session.set_prompt("one more")
    assert refused.done()
    with pytest.raises(EventRefused, match="bytes wait until the server answers them"):
        await refused
    with pytest.raises(EventRefused, match="opening a session was refused with OUTBOX_FULL"):
        await client.open("another")
    server.stream.take = take  # type: ignore[method-assign]
    for edit in taken:
        outcome = session_pb2.EditOutcome(event_seq=edit.event_seq, effective_frame=50)
        server.stream.push(session.handle, outcome=outcome)
    await asyncio.gather(*taken)
    assert (await session.set_prompt("what was answered waits no more")).effective_frame is not None


async def test_full_backlog_refuses_pause_and_resume_without_effect_but_not_close(client: MotionClient) -> None:
    session = await client.open("a person walks")
    edits = [session.set_prompt(f"prompt {number}") for number in range(12)]
    pausing = session.pause()
    assert not session.is_paused
    await check_refused(pausing)
    await asyncio.gather(*split_by_refusal(edits)[0])
    await session.pause()
    for number in range(12):
        session.set_prompt(f"prompt {number}")
    resuming = session.resume()
    assert session.is_paused
    assert (await session.close()).reason == "client"
    await check_refused(resuming)


async def test_playhead_reports_are_not_added_to_a_waiting_queue(client: MotionClient, server: FakeServer) -> None:
    async with client.stream() as stream:
        session = await stream.open("a person walks")
        await received(server, "playhead")
        for number in range(12):
            session.set_prompt(f"prompt {number}")
        queued_bytes = stream.backlog.queued_bytes
        assert session.is_reporting
        stream._report_playheads()
        assert stream.backlog.queued_bytes == queued_bytes


async def test_unanswered_bytes_of_a_session_leave_when_it_closes_or_moves(
    client: MotionClient, server: FakeServer
) -> None:
    async with client.stream() as other, client.stream() as stream:
        ending, moving = await stream.open("one"), await stream.open("two")
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)
        await until(lambda: not stream.is_connected)
        for session in (ending, moving):
            assert not session.set_prompt("while it is away").done()
        unanswered_bytes = stream.backlog.unanswered_bytes
        await ending.close()
        assert stream.backlog.unanswered_bytes == unanswered_bytes / 2
        stream.release(moving)
        moving.move(7, other, client.catalog, now=False)
        assert (stream.backlog.unanswered_bytes, other.backlog.unanswered_bytes) == (0, unanswered_bytes / 2)
        await moving.close()
        assert other.backlog.unanswered_bytes == 0
        with pytest.raises(SessionEnded):
            ending.set_prompt("after the end")


def test_send_queue_counts_the_bytes_of_its_events() -> None:
    counted = Backlog()
    queue = SendQueue(counted, lambda: 100)
    for number in range(1, 4):
        queue.put(an_event(number, "x" * 60))
    queue.put_ping(service_pb2.Ping(client_time_ns=5))
    assert counted.queued_bytes == 3 * (an_event(1, "x" * 60).ByteSize() + EVENT_BYTES)
    first = queue.take()
    assert ([event.event_seq for event in first.events], first.ping.client_time_ns) == ([1], 5)
    assert counted.queued_bytes == 2 * (an_event(1, "x" * 60).ByteSize() + EVENT_BYTES)
    queue.clear()
    assert counted.queued_bytes == 0
    assert not queue


def test_unanswered_event_counts_once_until_it_is_answered() -> None:
    """Also if it was sent again meanwhile: connections that are lost again and again must not add up."""
    counted = Backlog()
    held = Unanswered(counted)
    held.add(an_event(2))
    held.add(an_event(3))
    assert counted.unanswered_bytes == 2 * (an_event(3).ByteSize() + EVENT_BYTES)
    again = held.take_all()
    assert [event.event_seq for event in again] == [2, 3]
    assert counted.unanswered_bytes == 0
    for event in again:
        held.add(event)
    assert held.pop(3) == an_event(3)
    assert held.pop(3) is None
    assert counted.unanswered_bytes == an_event(2).ByteSize() + EVENT_BYTES
    held.clear()
    assert counted.unanswered_bytes == 0
