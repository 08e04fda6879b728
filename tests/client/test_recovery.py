"""Recovery from a lost connection: delays, and sessions that are reopened."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import (
    EventRefused,
    InvalidInput,
    LinePolicy,
    MotionClient,
    Priority,
    SessionOptions,
    StreamLost,
    convert,
)
from motiongen_client.backoff import FIRST_DELAY_S, LONGEST_DELAY_S, LONGEST_SOON_DELAY_S, SOON_S, Backoff
from tests.client.fake_server import FakeServer, FakeStream
from tests.client.waiting import received, until


def test_delays_grow_to_a_maximum_and_start_again_after_reset() -> None:
    backoff = Backoff(lambda: 1.0)
    delays = [backoff.next_s() for _ in range(24)]
    assert delays[0] == FIRST_DELAY_S
    assert delays == sorted(delays)
    assert delays[-1] == LONGEST_DELAY_S
    soon = [delay for number, delay in enumerate(delays) if sum(delays[:number]) < SOON_S]
    assert max(soon) == LONGEST_SOON_DELAY_S
    backoff.reset()
    assert backoff.next_s() == FIRST_DELAY_S
    assert backoff.next_s(7.0) == 7.0, "the server asked for more"


def test_delays_differ_from_client_to_client() -> None:
    assert Backoff(lambda: 0.0).next_s() == FIRST_DELAY_S / 2
    assert len({Backoff().next_s() for _ in range(20)}) > 10


@pytest.mark.parametrize("wrong", [{"recover_s": -1}, {"ping_s": 0}, {"pong_timeout_s": 0}, {"hello_timeout_s": -1}])
def test_invalid_line_policy_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match=next(iter(wrong))):
        LinePolicy(**wrong)


async def test_connect_waits_for_a_server_that_starts_later() -> None:
    server = FakeServer()  # its port is bound, but it does not answer yet
    connecting = asyncio.create_task(MotionClient(server.address, connect_timeout_s=60).connect())
    await asyncio.sleep(0)
    with server:
        client = await connecting
        assert client.catalog.models
        await client.close()


async def test_session_that_cannot_be_resumed_is_reopened_with_its_frames_and_prompts(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("one", later_prompts={500: "two"})
    await session.set_prompt("three")
    async for _ in session.frames(seconds=0.4, realtime=False):
        pass
    server.stream.end()
    await until(lambda: session.reopenings or None)
    opening = server.stream.received[0]
    assert opening.event_seq == 1
    assert opening.open.prior_frames.frame_count == 4
    frame = session.reopenings[0].frame
    assert frame >= 40
    assert [(each.text, each.start_frame) for each in opening.open.prompts] == [("three", 0), ("two", 500 - frame)]
    rest = [each.index async for each in session.frames(seconds=1, realtime=False)]
    assert rest == list(range(40, 140))
    edit = session.add_waypoint(1, 2, frame=frame + 100)
    assert (await edit).effective_frame is not None
    (sent,) = await received(server, "edit_constraints")
    assert sent.edit_constraints.upsert[0].frame == 100
    with pytest.raises(InvalidInput, match="frames still to come"):
        session.add_waypoint(1, 2, frame=frame - 10)


async def test_a_lost_connection_is_logged_once_with_its_cause(
    client: MotionClient, server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    session = await client.open("one")
    server.stream.end()
    await until(lambda: session.reopenings or None)
    said = [record.getMessage() for record in caplog.records if record.name == "motiongen_client.calls"]
    cause = "OK: the server ended the stream"
    assert said == [f"the connection to {server.address} was lost ({cause}); reconnecting"]


async def test_reopened_session_has_all_options_that_were_accepted(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("one", options=SessionOptions(text_guidance=2.0))
    server.refuse = lambda event: "NO_ROOM" if event.set_options.history_frames else ""
    edits = [
        session.set_options(denoise_steps=10, lookahead_frames=90),
        session.set_options(priority=Priority.HERO),
        session.set_options(guidance=(None, 3.0)),
    ]
    with pytest.raises(EventRefused, match="NO_ROOM"):
        await session.set_options(history_frames=8)
    assert all(edit.outcome for edit in edits)
    with pytest.raises(InvalidInput, match="denoise_steps"):
        session.set_options(denoise_steps=0)
    server.stream.end()
    await until(lambda: session.reopenings or None)
    opening = server.stream.received[0].open
    assert (opening.denoise_steps, opening.lookahead_frames, opening.history_frames) == (10, 90, 0)
    assert opening.priority == session_pb2.PRIORITY_CLASS_HERO
    assert opening.guidance == session_pb2.Guidance(constraint=3.0)


async def test_session_whose_frames_are_not_taken_reports_its_playhead(
    client: MotionClient, server: FakeServer
) -> None:
    await client.open("a person walks")
    reports = await received(server, "playhead", 2)
    assert {report.playhead.frame for report in reports} == {0}


async def test_paused_session_reports_its_playhead_after_reopening(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    async for _ in session.frames(seconds=0.2, realtime=False):
        pass
    await session.pause()
    server.stream.end()
    await until(lambda: session.reopenings or None)
    assert session.playback.playhead < session.reopenings[0].frame
    reports = await received(server, "playhead", 2)
    assert {report.playhead.frame for report in reports} == {0}, "it reports again although it is paused"
    await session.resume()
    assert session.is_reporting, "it reports, so that the server knows its playhead"


async def test_close_ends_the_session_if_the_connection_is_lost_before_the_answer(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = await client.open("a person walks")
    monkeypatch.setattr(server.stream, "close", lambda handle: None)
    closing = asyncio.create_task(session.close())
    await received(server, "close")
    server.stream.end()
    end = await closing
    assert "the connection was lost" in end.message
    assert await session.close() == end


async def test_reopened_session_seeks_earlier_frames_by_sending_them(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = await client.open("a person walks")
    async for _ in session.frames(seconds=0.4, realtime=False):
        pass
    monkeypatch.setattr(server.stream, "replan", lambda event: None)  # it is unanswered when the connection is lost
    waiting = session.seek(20)
    await received(server, "seek")
    server.stream.end()
    await until(lambda: session.reopenings or None)
    (again,) = await received(server, "seek")
    assert again.seek == convert.seek(None, session.motion(16, 20))
    assert (await waiting).effective_frame is not None
    await session.seek(12)
    assert (await received(server, "seek", 2))[-1].seek == convert.seek(None, session.motion(8, 12))
    frame = session.reopenings[0].frame
    await session.seek(frame + 5)
    assert (await received(server, "seek", 3))[-1].seek == session_pb2.Seek(frame=5)


async def test_reopened_session_is_not_sent_constraints_already_met(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    edits = [session.add_waypoint(1, 2, frame=500, last_frame=9000), session.add_waypoint(3, 4, frame=9000)]
    met, open_still = [(await edit, edit.constraint_ids[0])[1] for edit in edits]
    news = session_pb2.ConstraintReached(constraint_id=met, met=True, frame=510)
    server.stream.push(session.handle, constraint_reached=news)
    await session.constraint_reached(met)
    server.stream.end()
    await until(lambda: session.reopenings or None)
    opening = server.stream.received[0].open
    assert [each.constraint_id for each in opening.constraints] == [open_still]


async def test_reopened_session_does_not_remove_a_prompt_that_ended_by_itself(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    await session.set_prompt("a person waves", frame=10, end_frame=1000)
    async for _ in session.frames(seconds=0.4, realtime=False):
        pass
    server.stream.end()
    await until(lambda: session.reopenings or None)
    assert [each.text for each in server.stream.received[0].open.prompts] == ["a person walks", "a person waves"]
    async for _ in session.frames(seconds=1, realtime=False):
        pass
    await session.set_prompt("a person runs")
    (sent,) = await received(server, "edit_prompts")
    assert not sent.edit_prompts.remove, "a server refuses an edit that removes what has ended"


async def test_placements_of_a_reopened_session_are_in_frames_of_the_application(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    push = FakeStream.push

    def with_placement(stream: FakeStream, handle: int, **update: object) -> None:
        opened = update.get("opened")
        if isinstance(opened, session_pb2.SessionOpened):
            opened.placements.add(constraint_id=1, first_frame=3, last_frame=9, arrival_frame=5, anchor_frame=2)
        push(stream, handle, **update)

    monkeypatch.setattr(FakeStream, "push", with_placement)
    session = await client.open("a person walks")
    (before,) = session.opened.placements
    await until(lambda: session.playback.buffered_to or None)
    server.stream.end()
    await until(lambda: session.reopenings or None)
    frame = session.reopenings[0].frame
    (after,) = session.opened.placements
    assert frame > 0
    assert (before.first_frame, session.opened.start_frame) == (3, frame)
    assert (after.first_frame, after.last_frame, after.arrival_frame, after.anchor_frame) == (
        frame + 3,
        frame + 9,
        frame + 5,
        frame + 2,
    )


class Unauthenticated(grpc.Status):
    """The status with which a server refuses streams of a caller that it does not know."""

    code = grpc.StatusCode.UNAUTHENTICATED
    details = "unknown token"
    trailing_metadata = ()


async def test_refusal_that_another_call_would_get_again_ends_the_stream(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    server.turned_away = [Unauthenticated() for _ in range(9)]
    server.stream.end()
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    await until(lambda: waiting.done() or len(server.turned_away) < 8)
    assert len(server.turned_away) == 8, "it is not asked again"
    with pytest.raises(StreamLost, match="UNAUTHENTICATED: unknown token"):
        await waiting
