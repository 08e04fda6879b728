"""A session that ends while it is paused: the next look at it raises, and no caller waits for frames for ever."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import grpc
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import Frame, LinePolicy, MotionClient, MotiongenError, Session, SessionEnded, StreamLost
from motiongen_client.blocking import MotionClient as BlockingClient
from motiongen_client.blocking_session import Session as BlockingSession
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer
from tests.client.waiting import collect, until
from tests.waiting import LIMIT_S


def close_idle(server: FakeServer) -> None:
    closed = session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_IDLE, message="nobody was there")
    server.stream.push(1, closed=closed)


def lose_for_good(server: FakeServer) -> None:
    server.stream.fail(grpc.StatusCode.UNAUTHENTICATED)


ENDS = pytest.mark.parametrize(
    ("end", "error"), [(close_idle, SessionEnded), (lose_for_good, StreamLost)], ids=["closed", "lost"]
)
End = Callable[[FakeServer], None]


async def taken_until_error(frames: AsyncIterator[Frame]) -> list[int]:
    """The indices of the frames that come before the session ends with an error."""
    taken = []
    try:
        async for frame in frames:
            taken.append(frame.index)
    except SessionEnded:
        return taken
    raise AssertionError("nothing was raised")


def polled_until_error(session: BlockingSession, now_s: list[float]) -> set[int]:
    """The indices of the frames that poll returns, called twice per frame, before it raises SessionEnded."""
    shown = set()
    for _ in range(1000):
        try:
            frame = session.poll()
        except SessionEnded:
            return shown
        assert frame is not None
        shown.add(frame.index)
        now_s[0] += 0.005
    raise AssertionError("nothing was raised")


@pytest.fixture
async def session(clock: ManualClock, client: MotionClient) -> Session:
    """A session that shows its first frame, and has others."""
    session = await client.open("a person walks")
    await until(session.poll)
    await until(lambda: session.playback.buffered_to > 5)
    return session


@ENDS
async def test_next_look_at_a_paused_session_that_ended_raises(
    session: Session, server: FakeServer, end: End, error: type[MotiongenError]
) -> None:
    await session.pause()
    end(server)
    await until(lambda: session.is_over)
    for look in (session.poll, session.sample, session.glance):
        with pytest.raises(error):
            look()
    assert len(session.motion()) == 1, "the frame shown is kept"


@ENDS
async def test_waiting_for_frames_of_a_paused_session_raises_when_it_ends(
    client: MotionClient, server: FakeServer, end: End, error: type[MotiongenError]
) -> None:
    session = await client.open("a person walks")
    frames = session.frames()
    assert (await anext(frames)).index == 0
    await session.pause()
    waiting = asyncio.create_task(collect(frames))
    end(server)
    async with asyncio.timeout(LIMIT_S):
        with pytest.raises(error):
            await waiting
        with pytest.raises(error):
            await anext(session.frames())


async def test_frames_reached_before_the_pause_are_yielded_before_the_error(
    session: Session, clock: ManualClock, server: FakeServer
) -> None:
    frames = session.frames()
    clock.advance(0.03)
    assert (await anext(frames)).index == 1
    await session.pause()
    close_idle(server)
    await until(lambda: session.is_over)
    assert await taken_until_error(frames) == [2, 3]


async def test_frames_left_by_one_generator_are_yielded_by_the_next_before_the_error(
    session: Session, clock: ManualClock, server: FakeServer
) -> None:
    frames = session.frames()
    clock.advance(0.03)
    assert (await anext(frames)).index == 1
    await frames.aclose()
    await session.pause()
    close_idle(server)
    await until(lambda: session.is_over)
    assert await taken_until_error(session.frames()) == [2, 3]


async def test_ended_session_yields_all_received_frames_when_not_in_real_time(
    session: Session, server: FakeServer
) -> None:
    await session.pause()
    close_idle(server)
    await until(lambda: session.is_over)
    assert await taken_until_error(session.frames(realtime=False)) == list(range(1, session.playback.buffered_to))


async def test_ended_session_cannot_be_paused_resumed_or_sought(
    session: Session, clock: ManualClock, server: FakeServer
) -> None:
    close_idle(server)
    await until(lambda: session.is_over)
    with pytest.raises(SessionEnded):
        session.pause()
    clock.advance(0.01)
    frame = session.poll()
    assert frame is not None
    assert frame.index == 1, "the frames left are played"
    with pytest.raises(SessionEnded):
        session.resume()
    with pytest.raises(SessionEnded):
        session.seek(1)
    assert not session.is_paused


async def test_poll_raises_in_a_session_that_ended_before_its_first_frame(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    await session.pause()
    assert session.poll() is None
    close_idle(server)
    await until(lambda: session.is_over)
    with pytest.raises(SessionEnded):
        session.poll()


async def test_session_closed_by_the_application_keeps_its_frame_without_an_error(session: Session) -> None:
    await session.pause()
    await session.close()
    frame = session.poll()
    assert frame is not None
    assert frame.index == 0
    assert await collect(session.frames()) == []


@pytest.mark.parametrize("pauses", [True, False], ids=["paused", "playing"])
def test_blocking_poll_raises_in_a_session_that_ended_after_its_frames(
    server: FakeServer, pauses: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    with BlockingClient(server.address, policy=LinePolicy(recover_s=0)) as client:
        session = client.open("a person walks")
        inner = session._inner
        now_s = [100.0]
        monkeypatch.setattr(inner, "_clock", lambda: now_s[0])
        while session.poll() is None:
            pass
        while inner.playback.buffered_to < 20:
            pass
        if pauses:
            session.pause().wait()
            session.poll()  # this frame is held until an update comes
        close_idle(server)
        while session.end is None:
            pass
        assert polled_until_error(session, now_s) == (set() if pauses else set(range(inner.playback.buffered_to)))
        with pytest.raises(SessionEnded):
            next(iter(session.frames()))
