"""Frames taken sooner than they would be shown: later edits take effect after them, without a jump."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_client import MotionClient, Session
from motiongen_client.edit import Edit
from tests.client.conftest import ManualClock
from tests.client.fake_server import LEAD, FakeServer
from tests.client.synthetic import LOOKAHEAD
from tests.client.waiting import received, until

FPS = 100


async def opened(client: MotionClient) -> Session:
    """A session that holds all frames that it gets before its first report of a playhead."""
    session = await client.open("a person walks", keep_s=None)
    await until(lambda: session.playback.buffered_to == LOOKAHEAD)
    return session


async def take(session: Session, num_frames: int) -> None:
    async for _ in session.frames(num_frames / FPS, realtime=False):
        pass


async def check_begins_at_effective_frame(session: Session, edit: Edit) -> None:
    """No frame that was taken was replaced, and the edit's plan begins at its effective frame."""
    first = (await edit).effective_frame
    assert session.stats.late_plans == 0
    assert first is not None
    plans = session.motion(0, first + 1).root_translation_m[:, 0]
    assert np.diff(plans)[-1] > 0


@pytest.mark.parametrize("num_taken", [LEAD + 10, LOOKAHEAD])
async def test_edit_takes_effect_after_the_frames_that_were_taken(
    client: MotionClient, server: FakeServer, num_taken: int
) -> None:
    session = await opened(client)
    await take(session, num_taken)
    edit = session.set_velocity(1, 0)
    await edit
    await take(session, LOOKAHEAD)
    await check_begins_at_effective_frame(session, edit)
    told = [event.WhichOneof("event") for event in server.stream.received]
    assert told[told.index("set_velocity") - 1] == "playhead"
    assert server.stream.received[told.index("set_velocity") - 1].playhead.frame == num_taken - 1


async def test_frames_that_an_unanswered_edit_may_replace_are_not_yielded(client: MotionClient) -> None:
    session = await opened(client)
    await take(session, 20)
    edit = session.set_prompt("a person runs")
    await take(session, LOOKAHEAD)
    assert edit.done()
    await check_begins_at_effective_frame(session, edit)


async def test_edits_during_real_time_playback_send_no_extra_reports(
    clock: ManualClock, client: MotionClient, server: FakeServer
) -> None:
    session = await opened(client)
    assert session.poll() is not None
    await received(server, "playhead")  # of the first frame; the clock stands, so no report is due after it
    clock.advance(0.1)
    assert session.playback.playhead == 0
    frame = session.poll()
    assert frame is not None
    assert frame.index == 10
    for _ in range(3):
        await session.set_velocity(1, 0)
    assert len(await received(server, "set_velocity", 3)) == 3
    assert len(await received(server, "playhead")) == 1


async def test_taking_the_last_frame_held_is_reported_without_waiting_for_the_next_report(
    clock: ManualClock, client: MotionClient, server: FakeServer
) -> None:
    session = await opened(client)
    await take(session, LOOKAHEAD)
    (report,) = await received(server, "playhead")
    assert report.playhead.frame == LOOKAHEAD - 1, "the clock stands still, so no regular report is due"
