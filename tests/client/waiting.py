"""How tests of sessions wait and play frames."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import TypeVar

from motiongen.v1 import session_pb2
from motiongen_client import (
    Frame,
    Session,
)
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer

T = TypeVar("T")


async def until(condition: Callable[[], T | None]) -> T:
    """Let the event loop run until a condition returns something, and return that."""
    while not (found := condition()):  # noqa: ASYNC110  the condition may depend on another thread
        await asyncio.sleep(0)
    return found


async def play(session: Session, clock: ManualClock, seconds: float) -> AsyncIterator[Frame]:
    """Frames in the time of the manual clock, which advances once the next frame has arrived."""
    async for frame in session.frames(seconds):
        yield frame
        await until(lambda: session.playback.buffered_to > session.playback.playhead + 1)
        clock.advance(1 / session.rig.frame_rate_hz)


async def received(server: FakeServer, kind: str, count: int = 1) -> list[session_pb2.SessionEvent]:
    """The events of a kind that the server has received, once there are at least count of them."""

    def events() -> list[session_pb2.SessionEvent] | None:
        found = [event for event in server.stream.received if event.WhichOneof("event") == kind]
        return found if len(found) >= count else None

    return await until(events)


async def collect(frames: AsyncIterator[Frame]) -> list[int]:
    return [frame.index async for frame in frames]
