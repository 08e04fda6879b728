"""Asynchronous sessions with the fake server: opening, frames, playback, the end."""

from __future__ import annotations

import asyncio

import pytest

from motiongen.v1 import session_pb2
from motiongen_client import (
    EventRefused,
    InvalidInput,
    MotionClient,
    Priority,
    ServiceLevel,
    SessionEnded,
    SessionOptions,
    StartPose,
    Waypoint,
)
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer
from tests.client.synthetic import HORIZON
from tests.client.waiting import collect, play, received, until


async def test_open_sends_the_options_and_returns_the_servers_choices(client: MotionClient, server: FakeServer) -> None:
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


async def test_frames_in_real_time_are_yielded_once_each_in_order(client: MotionClient) -> None:
    session = await client.open("a person walks")
    frames = [frame async for frame in session.frames(seconds=1)]
    assert [frame.index for frame in frames] == list(range(100))
    assert frames[99].root_translation_m[2] == pytest.approx(4.95)
    assert session.stats.plans >= 100 // HORIZON
    assert session.stats.first_frame_s is not None


async def test_frames_not_in_real_time_are_all_yielded_without_underruns(client: MotionClient) -> None:
    session = await client.open("a person walks", keep_s=None)
    frames = [frame.index async for frame in session.frames(seconds=6, realtime=False)]
    assert frames == list(range(600))
    assert session.stats.underruns == 0
    assert len(session.motion()) == 600


async def test_playheads_are_reported_in_order_without_event_numbers(
    clock: ManualClock, client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    clock.advance(0.3)
    async for _ in play(session, clock, 0.6):
        pass
    reports = await received(server, "playhead", 2)
    played = [report.playhead.frame for report in reports]
    assert played == sorted(played)
    assert all(report.event_seq == 0 for report in reports)
    assert reports[-1].playhead.buffered_to > reports[-1].playhead.frame


async def test_refused_open_raises_and_the_stream_is_used_again(client: MotionClient, server: FakeServer) -> None:
    server.refuse = lambda event: "UNKNOWN_MODEL" if event.open.model_id == "none" else ""
    with pytest.raises(EventRefused, match="opening a session was refused with UNKNOWN_MODEL"):
        await client.open("a person walks", options=SessionOptions(model_id="none"))
    session = await client.open("a person walks")
    assert [frame.index async for frame in session.frames(seconds=0.1)]
    assert len(server.streams) == 1


async def test_pause_holds_the_frame_and_resume_continues_after_it(clock: ManualClock, client: MotionClient) -> None:
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
    session.poll()  # the next frame is due one frame time after this
    clock.advance(0.01)
    later = [frame.index async for frame in play(session, clock, 0.1)]
    assert later == list(range(held.index + 1, held.index + 11))


async def test_poll_returns_the_frame_due_now(clock: ManualClock, client: MotionClient) -> None:
    session = await client.open("a person walks")
    first = await until(session.poll)
    await until(lambda: session.playback.buffered_to > 5)
    clock.advance(0.05)
    later = session.poll()
    assert later is not None
    assert (first.index, later.index) == (0, 5)


async def test_frames_that_a_late_reader_left_are_yielded_by_the_next_generator(
    clock: ManualClock, client: MotionClient
) -> None:
    session = await client.open("a person walks")
    await until(lambda: session.playback.buffered_to > 30)
    frames = session.frames()
    assert (await anext(frames)).index == 0
    clock.advance(0.1)  # ten more are due now
    assert [(await anext(frames)).index for _ in range(3)] == [1, 2, 3]
    await frames.aclose()
    assert [frame.index async for frame in session.frames(seconds=0.04)] == [4, 5, 6, 7]
    assert (await anext(session.frames())).index == 8


async def test_reader_that_is_always_late_gets_frames_without_waiting(clock: ManualClock, client: MotionClient) -> None:
    session = await client.open("a person walks")
    await until(lambda: session.playback.buffered_to > 30)
    taken = []
    async for frame in session.frames(seconds=0.3):
        taken.append(frame.index)
        clock.advance(0.01)  # the next frame is due before it is requested; nothing else advances the clock
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


async def test_session_ended_by_the_server_plays_its_frames_then_raises(
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


async def test_change_of_service_level_is_called_back(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    assert session.service_level == ServiceLevel("full", 4)
    told: asyncio.Queue[ServiceLevel] = asyncio.Queue()
    session.on_service_level = told.put_nowait
    level = session_pb2.ServiceLevel(tier=session_pb2.SERVICE_TIER_FEWER_STEPS, denoise_steps=3)
    server.stream.push(session.handle, service_level=level)
    assert await told.get() == session.service_level == ServiceLevel("fewer_steps", 3)
    server.stream.push(session.handle, service_level=session_pb2.ServiceLevel(tier=99))  # type: ignore[arg-type]
    assert await told.get() == ServiceLevel("unspecified", 0)


async def test_session_closed_for_overload_raises_with_that_reason(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    server.stream.push(session.handle, closed=session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_OVERLOAD))
    with pytest.raises(SessionEnded, match="overload"):
        await collect(session.frames())


async def test_late_reader_gets_every_frame_even_if_none_is_kept(clock: ManualClock, client: MotionClient) -> None:
    session = await client.open("a person walks", keep_s=0)
    await until(lambda: session.playback.buffered_to > 6)
    shown = []
    async for frame in session.frames():
        shown.append(frame.index)
        if len(shown) == 6:
            break
        clock.advance(3 / session.rig.frame_rate_hz)
    assert shown == list(range(6))


async def test_time_to_keep_that_no_frame_number_can_hold_is_refused_and_ends_no_stream(client: MotionClient) -> None:
    session = await client.open("a person walks")
    with pytest.raises(InvalidInput, match="keep_s"):
        await client.open("a person walks", keep_s=1e308)
    assert (await session.set_prompt("a person runs")).effective_frame is not None
    assert session.reopenings == ()
