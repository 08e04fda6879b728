"""Playback at another pace: readers notice at once, and a pace that changes all the time does not stop it."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from motiongen_client import Frame, InvalidInput, MotionClient, Playback, Session
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


def playback_of(num_frames: int) -> Playback:
    """At 20 frames a second; frame 0 is shown at 0 s."""
    playback = Playback(20, 1)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, np.zeros((num_frames, 1), np.float32), 0)
    playback.advance(0.0)
    return playback


def test_pace_that_is_set_at_every_tick_does_not_stop_playback() -> None:
    playback, frames, pace = playback_of(100), 0.0, 1.0
    for tick in range(1, 241):  # at 60 Hz, into slow motion
        frames += 20 * pace / 60
        pace = 1 - tick / 480
        playback.set_time_scale(pace)
        playback.advance(tick / 60)
        assert playback.playhead == int(frames + 1e-6)
    assert playback.share(4.0) == pytest.approx(frames - playback.playhead)


def test_frame_times_of_a_hold_are_counted_at_the_pace_of_their_time() -> None:
    playback = playback_of(1)
    playback.advance(0.1)
    assert playback.underruns == 2
    playback.set_time_scale(2.0)
    playback.advance(0.2)  # until here, at the pace before
    assert playback.underruns == 4
    playback.advance(0.3)
    assert playback.underruns == 8


@pytest.mark.parametrize("scale", [1e308, 5e-324], ids=["endless frames", "endless frame times"])
def test_pace_that_no_clock_can_run_at_is_refused(scale: float) -> None:
    with pytest.raises(InvalidInput, match="scale"):
        playback_of(1).set_time_scale(scale)


def test_playback_that_all_but_stood_still_goes_on_from_there() -> None:
    playback = playback_of(9)
    playback.set_time_scale(1e-300)
    for now_s in (0.06, 1.0, 1e6):
        playback.advance(now_s)
        assert playback.playhead == 1
    playback.set_time_scale(1.0)
    playback.advance(1e6)
    playback.advance(1e6 + 0.05)
    assert playback.playhead == 2
