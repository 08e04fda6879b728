"""A session that ends while its playhead stands: who looks at it hears so, and nobody waits for frames for ever."""

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


async def rest(frames: AsyncIterator[Frame]) -> list[int]:
    """Those that come before it is over otherwise than by its user."""
    taken = []
    try:
        async for frame in frames:
            taken.append(frame.index)
    except SessionEnded:
        return taken
    raise AssertionError("nothing was raised")


def looks(session: BlockingSession, now_s: list[float]) -> set[int]:
    """The frames that are found, asked for twice a frame, before that is raised."""
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
    """One that shows its first frame, and has others."""
    session = await client.open("a person walks")
    await until(session.poll)
    await until(lambda: session.playback.buffered_to > 5)
    return session


@ENDS
async def test_the_next_look_says_so(
    session: Session, server: FakeServer, end: End, error: type[MotiongenError]
) -> None:
    await session.pause()
    end(server)
    await until(lambda: session.is_over)
    for look in (session.poll, session.sample, session.glance):
        with pytest.raises(error):
            look()
    assert len(session.motion()) == 1, "what was shown stays"


@ENDS
async def test_who_waits_for_frames_is_told(
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


async def test_frames_that_were_reached_before_the_pause_are_given_first(
    session: Session, clock: ManualClock, server: FakeServer
) -> None:
    frames = session.frames()
    clock.advance(0.03)
    assert (await anext(frames)).index == 1
    await session.pause()
    close_idle(server)
    await until(lambda: session.is_over)
    assert await rest(frames) == [2, 3]


async def test_who_left_some_of_them_is_given_those_by_the_next(
    session: Session, clock: ManualClock, server: FakeServer
) -> None:
    frames = session.frames()
    clock.advance(0.03)
    assert (await anext(frames)).index == 1
    await frames.aclose()
    await session.pause()
    close_idle(server)
    await until(lambda: session.is_over)
    assert await rest(session.frames()) == [2, 3]


async def test_frames_that_need_no_clock_are_given_to_the_last(session: Session, server: FakeServer) -> None:
    await session.pause()
    close_idle(server)
    await until(lambda: session.is_over)
    assert await rest(session.frames(realtime=False)) == list(range(1, session.playback.buffered_to))


async def test_one_that_is_over_is_neither_paused_nor_let_go_on(
    session: Session, clock: ManualClock, server: FakeServer
) -> None:
    close_idle(server)
    await until(lambda: session.is_over)
    with pytest.raises(SessionEnded):
        session.pause()
    clock.advance(0.01)
    frame = session.poll()
    assert frame is not None
    assert frame.index == 1, "what is left is played"
    with pytest.raises(SessionEnded):
        session.resume()
    with pytest.raises(SessionEnded):
        session.seek(1)
    assert not session.is_paused


async def test_one_that_never_showed_a_frame_says_so_too(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    await session.pause()
    assert session.poll() is None
    close_idle(server)
    await until(lambda: session.is_over)
    with pytest.raises(SessionEnded):
        session.poll()


async def test_one_that_its_user_closed_keeps_its_frame(session: Session) -> None:
    await session.pause()
    await session.close()
    frame = session.poll()
    assert frame is not None
    assert frame.index == 0
    assert await collect(session.frames()) == []


@pytest.mark.parametrize("pauses", [True, False], ids=["paused", "playing"])
def test_without_asyncio_the_next_look_says_so_as_well(
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
            session.poll()  # which is known to hold until something comes
        close_idle(server)
        while session.end is None:
            pass
        assert looks(session, now_s) == (set() if pauses else set(range(inner.playback.buffered_to)))
        with pytest.raises(SessionEnded):
            next(iter(session.frames()))
