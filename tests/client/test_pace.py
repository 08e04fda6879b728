"""Playback at another pace: readers notice at once, and a pace that changes all the time does not stop it."""

from __future__ import annotations

import asyncio

from motiongen_client import Frame, MotionClient, Session
from tests.client.conftest import ManualClock
from tests.client.waiting import until


async def waiting_in_slow_motion(session: Session, clock: ManualClock) -> asyncio.Task[Frame | None]:
    """A reader that has shown frame 0 and waits for frame 1, which is due in 10 s."""
    await until(lambda: session.playback.buffered_to > 1)
    session.set_time_scale(0.001)
    frames = session.frames()
    assert (await anext(frames)).index == 0
    reading = asyncio.create_task(anext(frames, None))
    await turns()
    clock.advance(5.0)
    await turns()
    assert not reading.done()
    return reading


async def turns() -> None:
    for _ in range(20):  # of the event loop: until all that is due has run
        await asyncio.sleep(0)


async def test_waiting_reader_gets_its_frame_when_the_new_time_scale_makes_it_due(
    clock: ManualClock, client: MotionClient
) -> None:
    session = await client.open("a person walks")
    reading = await waiting_in_slow_motion(session, clock)
    session.set_time_scale(1.0)
    await turns()
    clock.advance(0.01)
    await turns()
    assert reading.done(), "a frame time of 10 ms is over, though not the 10 s that it began to wait for"
    frame = reading.result()
    assert frame is not None
    assert frame.index == 1


async def test_waiting_reader_ends_when_the_session_is_closed(clock: ManualClock, client: MotionClient) -> None:
    session = await client.open("a person walks")
    reading = await waiting_in_slow_motion(session, clock)
    await session.close()
    await turns()
    assert reading.done()
    assert reading.result() is None
