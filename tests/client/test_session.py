"""Async sessions against the fake server: opening, frames, edits, the end, and what a broken server does to them."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import AsyncIterator, Callable
from typing import TypeVar

import grpc
import numpy as np
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import (
    EventRefused,
    Frame,
    InvalidInput,
    MotionClient,
    Priority,
    ProtocolViolation,
    ServerUnavailable,
    ServiceLevel,
    Session,
    SessionEnded,
    SessionOptions,
    StartPose,
    StreamLost,
    Waypoint,
)
from tests.client.conftest import ManualClock
from tests.client.fake_server import HORIZON, FakeServer

T = TypeVar("T")


@pytest.fixture
async def client(server: FakeServer) -> AsyncIterator[MotionClient]:
    async with MotionClient(server.address) as connected:
        yield connected


async def until(condition: Callable[[], T | None]) -> T:
    """Let the event loop go round until a condition gives something, and return that."""
    while not (found := condition()):  # noqa: ASYNC110  what is waited for may be of another thread
        await asyncio.sleep(0)
    return found


async def play(session: Session, clock: ManualClock, seconds: float) -> AsyncIterator[Frame]:
    """Frames in the time of the clock, which goes on when the next one is there."""
    async for frame in session.frames(seconds):
        yield frame
        await until(lambda: session.playback.buffered_to > session.playback.playhead + 1)
        clock.advance(1 / session.rig.frame_rate_hz)


async def received(server: FakeServer, kind: str, count: int = 1) -> list[session_pb2.SessionEvent]:
    """The events of a kind that the server got, once there are so many."""

    def events() -> list[session_pb2.SessionEvent] | None:
        found = [event for event in server.stream.received if event.WhichOneof("event") == kind]
        return found if len(found) >= count else None

    return await until(events)


async def collect(frames: AsyncIterator[Frame]) -> list[int]:
    return [frame.index async for frame in frames]


async def test_the_catalogue_is_there_once_connected(client: MotionClient) -> None:
    assert client.catalog.models[0].model_id == "synthetic"
    assert client.catalog.rig("stick9").joint_names[0] == "Hips"


async def test_open_sends_what_was_asked_and_tells_what_the_server_chose(
    client: MotionClient, server: FakeServer
) -> None:
    options = SessionOptions(seed=11, priority=Priority.HERO, start=StartPose(1, 2, 0.5), text_guidance=1.5)
    session = await client.open(
        "a person walks", later_prompts={60: "a person runs"}, options=options, constraints=[Waypoint(50, 1, 2)]
    )
    (event,) = await received(server, "open")
    assert (event.event_seq, event.open.seed) == (1, 11)
    assert event.open.priority == session_pb2.PRIORITY_CLASS_HERO
    assert [(span.start_frame, span.text) for span in event.open.prompts] == [
        (0, "a person walks"),
        (60, "a person runs"),
    ]
    assert event.open.constraints[0].frame == 50
    assert event.open.start_pose.heading == 0.5
    assert event.open.guidance.text == 1.5
    assert not event.open.guidance.HasField("constraint")
    assert (session.opened.seed, session.opened.session_id) == (11, "s1")
    assert server.stream.agent.startswith("motiongen-python/")


async def test_frames_come_once_each_in_order_in_real_time(client: MotionClient) -> None:
    session = await client.open("a person walks")
    frames = [frame async for frame in session.frames(seconds=1)]
    assert [frame.index for frame in frames] == list(range(100))
    assert frames[99].root_translation_m[2] == pytest.approx(4.95)
    assert session.stats.plans >= 100 // HORIZON
    assert session.stats.first_frame_s is not None


async def test_frames_come_as_fast_as_they_are_made_when_asked(client: MotionClient) -> None:
    session = await client.open("a person walks", keep_s=None)
    frames = [frame.index async for frame in session.frames(seconds=6, realtime=False)]
    assert frames == list(range(600))
    assert session.stats.underruns == 0
    assert len(session.motion()) == 600


async def test_a_new_prompt_replaces_what_was_not_played_and_says_from_where(
    clock: ManualClock, client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks", keep_s=None)
    edit = None
    async for frame in play(session, clock, 1):
        if frame.index == 20:
            edit = session.set_prompt("a person runs")
            clock.advance(0.005)
            await edit
    assert edit is not None
    outcome = await edit
    assert outcome.effective_frame is not None
    plans = session.motion().root_translation_m[:, 0]
    assert outcome.effective_frame > 20
    assert plans[outcome.effective_frame] > plans[outcome.effective_frame - 1]
    assert edit.latency_s == pytest.approx(0.005)
    assert server.stream.characters[session.handle].prompts == {1: "a person runs"}


async def test_playheads_are_reported_once_playing(
    clock: ManualClock, client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    clock.advance(0.3)
    await session.set_prompt("a person runs")  # goes behind a report, if there is one
    assert not [event for event in server.stream.received if event.WhichOneof("event") == "playhead"]
    async for _ in play(session, clock, 0.6):
        pass
    reports = await received(server, "playhead", 2)
    played = [report.playhead.frame for report in reports]
    assert played == sorted(played)
    assert all(report.event_seq == 0 for report in reports)
    assert reports[-1].playhead.buffered_to > reports[-1].playhead.frame


async def test_many_sessions_share_one_call(client: MotionClient, server: FakeServer) -> None:
    async def play(session: Session) -> int:
        return [frame.index async for frame in session.frames(seconds=0.5)][-1]

    async with client.stream() as stream:
        sessions = await asyncio.gather(*(stream.open(f"character {number}") for number in range(20)))
        assert await asyncio.gather(*map(play, sessions)) == [49] * 20
        assert len(stream.sessions) == 20
        ends = await asyncio.gather(*(session.close() for session in sessions))
        assert {end.reason for end in ends} == {"client"}
        assert stream.sessions == ()
    assert len(server.streams) == 1


async def test_scheduled_prompts_that_have_passed_make_room(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("one")
    for frame, text in ((20, "two"), (40, "three")):
        await session.set_prompt(text, frame=frame)
    async for _ in session.frames(seconds=0.5):
        pass
    await session.set_prompt("four", frame=500)
    assert sorted(server.stream.characters[1].prompts.values()) == ["four", "one", "three"]
    await session.set_prompt("five")
    assert sorted(server.stream.characters[1].prompts.values()) == ["five", "four"]


async def test_constraints_are_added_replaced_and_removed_by_id(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    first = session.add_waypoint(1, 2, frame=30)
    second = session.add_trajectory(np.zeros((3, 2)), first_frame=40)
    await second
    character = server.stream.characters[session.handle]
    assert (first.constraint_ids, second.constraint_ids) == ((1,), (2,))
    assert character.constraint_ids == {1, 2}
    await session.remove_constraints(first.constraint_ids)
    assert character.constraint_ids == {2}
    await session.set_constraints([Waypoint(50, 0, 0), Waypoint(60, 0, 0)])
    assert character.constraint_ids == {3, 4}
    await session.clear_constraints()
    assert character.constraint_ids == set()


async def test_a_refusal_raises_where_awaited_and_the_session_goes_on(
    client: MotionClient, server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    server.refuse = lambda event: "BLANK_PROMPT" if event.WhichOneof("event") == "edit_prompts" else ""
    session = await client.open("a person walks")
    with caplog.at_level(logging.WARNING), pytest.raises(EventRefused, match="BLANK_PROMPT") as refusal:
        await session.set_prompt("  ")
    assert (refusal.value.code, refusal.value.field) == ("INVALID_ARGUMENT", "edit_prompts.x")
    assert refusal.value.allowed == "other things"
    assert "BLANK_PROMPT" in caplog.text
    assert len([frame async for frame in session.frames(seconds=0.2)]) == 20


async def test_a_refused_open_raises_and_leaves_the_stream_alive(client: MotionClient, server: FakeServer) -> None:
    server.refuse = lambda event: "UNKNOWN_MODEL" if event.open.model_id == "none" else ""
    with pytest.raises(EventRefused, match="opening a session was refused with UNKNOWN_MODEL"):
        await client.open("a person walks", options=SessionOptions(model_id="none"))
    session = await client.open("a person walks")
    assert [frame.index async for frame in session.frames(seconds=0.1)]
    assert len(server.streams) == 1


async def test_pause_holds_the_frame_and_resume_goes_on(clock: ManualClock, client: MotionClient) -> None:
    session = await client.open("a person walks")
    assert [frame.index async for frame in play(session, clock, 0.1)] == list(range(10))
    outcome = await session.pause()
    assert outcome.effective_frame is None
    held = session.poll()
    clock.advance(0.05)
    still = session.poll()
    assert held is not None
    assert still is not None
    assert held.index == still.index
    await session.resume()
    session.poll()  # the next is due one frame time after this
    clock.advance(0.01)
    later = [frame.index async for frame in play(session, clock, 0.1)]
    assert later == list(range(held.index + 1, held.index + 11))


async def test_poll_gives_the_frame_of_now(clock: ManualClock, client: MotionClient) -> None:
    session = await client.open("a person walks")
    first = await until(session.poll)
    await until(lambda: session.playback.buffered_to > 5)
    clock.advance(0.05)
    later = session.poll()
    assert later is not None
    assert (first.index, later.index) == (0, 5)


async def test_frames_that_a_late_reader_has_not_taken_are_not_lost(clock: ManualClock, client: MotionClient) -> None:
    session = await client.open("a person walks")
    await until(lambda: session.playback.buffered_to > 30)
    frames = session.frames()
    assert (await anext(frames)).index == 0
    clock.advance(0.1)  # ten more are due now
    assert [(await anext(frames)).index for _ in range(3)] == [1, 2, 3]
    await frames.aclose()
    assert [frame.index async for frame in session.frames(seconds=0.04)] == [4, 5, 6, 7]
    assert (await anext(session.frames())).index == 8


async def test_a_reader_that_is_always_late_is_given_frames_without_a_wait(
    clock: ManualClock, client: MotionClient
) -> None:
    session = await client.open("a person walks")
    await until(lambda: session.playback.buffered_to > 30)
    taken = []
    async for frame in session.frames(seconds=0.3):
        taken.append(frame.index)
        clock.advance(0.01)  # the next is due before it is asked for, and nothing else moves the clock
    assert taken == list(range(30))
    assert session.stats.underruns == 0


async def test_closing_ends_frames_and_returns_the_same_end_again(client: MotionClient) -> None:
    session = await client.open("a person walks")
    playing = asyncio.create_task(anext(session.frames()))
    await playing
    end = await session.close()
    assert (end.reason, end.frames > 0) == ("client", True)
    assert await session.close() is end
    assert [frame async for frame in session.frames()] == []
    with pytest.raises(SessionEnded, match="client"):
        session.set_prompt("too late")


async def test_a_session_the_server_ends_plays_what_is_left_then_raises(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    frames = session.frames()
    await anext(frames)
    closed = session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_ENGINE_FAULT, code=13, message="not finite")
    server.stream.push(session.handle, closed=closed)
    with pytest.raises(SessionEnded, match=r"engine_fault.*not finite"):
        await collect(frames)
    assert session.playback.playhead == session.playback.buffered_to - 1
    other = await client.open("another one")
    assert [frame.index async for frame in other.frames(seconds=0.05)]


@pytest.mark.parametrize("code", [grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.INTERNAL])
async def test_a_lost_stream_is_told_to_every_session_and_edit(
    client: MotionClient, server: FakeServer, code: grpc.StatusCode
) -> None:
    one, two = await client.open("one"), await client.open("two")
    server.refuse = lambda event: server.stream.fail(code) or ""  # type: ignore[func-returns-value]
    with pytest.raises(StreamLost, match=f"{code.name}: as the test wished"):
        await one.set_prompt("never answered")
    with pytest.raises(StreamLost):
        await collect(one.frames())
    with pytest.raises(StreamLost):
        await collect(two.frames(realtime=False))
    assert two.playback.playhead == two.playback.buffered_to - 1, "what had come was played"
    with pytest.raises(StreamLost):
        one.set_prompt("again")


async def test_a_server_that_breaks_the_rules_is_given_up(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    notice = session_pb2.PlanNotice(plan=1, valid_from=0, cause=session_pb2.PLAN_CAUSE_EDIT)
    server.stream.push(session.handle, plan=notice)
    with pytest.raises(ProtocolViolation, match="plans must rise"):
        async for _ in session.frames():
            pass


async def test_updates_it_does_not_know_are_ignored(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    server.stream.push(session.handle)
    server.stream.push(999, closed=session_pb2.SessionClosed())
    assert len([frame async for frame in session.frames(seconds=0.1)]) == 10


async def test_an_event_too_big_for_a_message_is_refused_here(client: MotionClient) -> None:
    session = await client.open("a person walks")
    with pytest.raises(InvalidInput, match="at most 3686 bytes"):
        session.add_trajectory(np.zeros((1000, 2)), first_frame=10)
    assert (await session.set_prompt("still in order")).event_seq == 2


async def test_a_full_send_queue_is_split_over_messages(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    edits = [session.set_prompt("x" * 90) for _ in range(200)]
    assert [(await edit).event_seq for edit in edits] == list(range(2, 202))


async def test_no_server_is_said_with_the_address() -> None:
    with pytest.raises(ServerUnavailable, match=r"127\.0\.0\.1:1: UNAVAILABLE"):
        await MotionClient("127.0.0.1:1").connect()


@pytest.mark.parametrize("address", ["", "localhost", "localhost:", "localhost:0", "localhost:x", ":50051"])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(InvalidInput, match="host:port"):
        MotionClient(address)


@pytest.mark.parametrize("report_hz", [0.5, 6.0])
async def test_report_rates_out_of_range_are_refused(client: MotionClient, report_hz: float) -> None:
    with pytest.raises(InvalidInput, match="from 1 to 5"):
        client.stream(report_hz=report_hz)


async def test_the_round_trip_is_measured(client: MotionClient) -> None:
    async with client.stream() as stream:
        assert 0 < await until(lambda: stream.round_trip_s) < 5


async def test_the_round_trip_is_told_to_the_server_as_soon_as_it_is_known(
    client: MotionClient, server: FakeServer
) -> None:
    async with client.stream():
        first, second = (await until(lambda: server.stream.pings if len(server.stream.pings) > 1 else None))[:2]
    assert not first.HasField("round_trip")
    assert 0 < second.round_trip.ToTimedelta().total_seconds() < 5


async def test_a_velocity_is_sent_in_metres_a_second_and_frames(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    outcome = await session.set_velocity(1.5, -0.5, seconds=0.25, heading_rad=0.0)
    (event,) = await received(server, "set_velocity")
    velocity = event.set_velocity
    assert (velocity.x, velocity.z, velocity.hold_frames) == (1.5, -0.5, 25)
    assert velocity.HasField("heading")
    assert outcome.effective_frame is not None
    await session.set_velocity(0, 0)
    assert not server.stream.received[-1].set_velocity.HasField("heading")


@pytest.mark.parametrize("wrong", [{"x_mps": math.nan}, {"z_mps": math.inf}, {"seconds": math.nan}])
async def test_a_velocity_that_is_no_number_is_refused_here(client: MotionClient, wrong: dict[str, float]) -> None:
    session = await client.open("a person walks")
    with pytest.raises(InvalidInput, match="finite"):
        session.set_velocity(**{"x_mps": 0.0, "z_mps": 0.0, **wrong})


async def test_a_change_of_service_is_told(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    assert session.service_level == ServiceLevel("full", 4)
    told: asyncio.Queue[ServiceLevel] = asyncio.Queue()
    session.on_service_level = told.put_nowait
    level = session_pb2.ServiceLevel(tier=session_pb2.SERVICE_TIER_FEWER_STEPS, denoise_steps=3)
    server.stream.push(session.handle, service_level=level)
    assert await told.get() == session.service_level == ServiceLevel("fewer_steps", 3)
    server.stream.push(session.handle, service_level=session_pb2.ServiceLevel(tier=99))  # type: ignore[arg-type]
    assert await told.get() == ServiceLevel("unspecified", 0)


async def test_a_refusal_says_when_to_ask_again(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    refusal = session_pb2.EditOutcome(event_seq=2, code=8, reason="OVERLOADED", message="full")
    refusal.retry_after.FromMilliseconds(1500)

    def refuse_later(event: session_pb2.SessionEvent) -> str:
        if event.WhichOneof("event") == "edit_prompts":
            server.stream.push(event.session, outcome=refusal)
            return "ANSWERED"
        return ""

    server.refuse = refuse_later
    with pytest.raises(EventRefused, match=r"try again in 1\.5 s") as refused:
        await session.set_prompt("a person runs")
    assert refused.value.retry_after_s == 1.5


async def test_an_end_for_overload_is_named(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    server.stream.push(session.handle, closed=session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_OVERLOAD))
    with pytest.raises(SessionEnded, match="overload"):
        await collect(session.frames())


async def test_frames_before_the_session_is_opened_break_the_rules(client: MotionClient, server: FakeServer) -> None:
    def answer_with_a_plan(event: session_pb2.SessionEvent) -> str:
        server.stream.push(event.session, plan=session_pb2.PlanNotice(plan=1))
        return ""

    server.refuse = answer_with_a_plan
    with pytest.raises(ProtocolViolation, match="before the session was opened"):
        await client.open("a person walks")


async def test_a_rig_the_catalogue_does_not_have_breaks_the_rules(client: MotionClient, server: FakeServer) -> None:
    def open_on_another(event: session_pb2.SessionEvent) -> str:
        server.stream.push(event.session, opened=session_pb2.SessionOpened(rig_id="other"))
        return ""

    server.refuse = open_on_another
    with pytest.raises(ProtocolViolation, match="no rig is called 'other'"):
        await client.open("a person walks")


async def test_an_edit_beyond_everything_planned_is_timed_by_its_effective_frame(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")

    def accept_at_120(event: session_pb2.SessionEvent) -> str:
        if event.WhichOneof("event") != "edit_constraints":
            return ""
        accepted = session_pb2.EditOutcome(event_seq=event.event_seq, effective_frame=120)
        server.stream.push(event.session, outcome=accepted)
        return "ANSWERED"  # the second answer to the same event, which a client drops

    server.refuse = accept_at_120
    edit = session.add_waypoint(1, 2, frame=120)
    assert (await edit).effective_frame == 120
    assert edit.latency_s is None
    async for _ in session.frames(seconds=1.3, realtime=False):
        pass
    assert edit.latency_s is not None
