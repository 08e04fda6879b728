"""Cuts that become known after the playhead has passed them: they show at the next frame, without interpolation."""

from __future__ import annotations

import pytest

from motiongen.v1 import session_pb2
from motiongen_client import Playback, Rig, convert
from motiongen_client.sampling import Sampler
from tests.client.line import Line, answer, frames, open_anew, open_session, opened
from tests.client.synthetic import catalog, synthetic_rows

NEAR_M, FAR_M = 1, 9  # where the motion before a cut is, and the motion after it


@pytest.fixture
def playback(stick_rig: Rig) -> Playback:
    playback = Playback(stick_rig.frame_rate_hz, stick_rig.row_width)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, synthetic_rows(NEAR_M, 0, 10), 0)
    playback.advance(0.0)
    return playback


@pytest.mark.parametrize("is_in_plan", [True, False])
def test_cut_already_passed_shows_at_the_next_frame(stick_rig: Rig, playback: Playback, is_in_plan: bool) -> None:
    sampler = Sampler(stick_rig, playback)
    playback.advance(0.26)
    sampler.row(0.26)  # frames 3 to 5 have been shown
    playback.announce_plan(2, 3, is_cut=is_in_plan)
    assert playback.note_cut(4) == 6
    playback.add_chunk(2, 3, synthetic_rows(FAR_M, 3, 9), 0)
    assert [frame for frame in range(12) if playback.is_cut(frame)] == [6]
    seen = []
    for tick in range(27, 40):
        playback.advance(tick / 100)
        seen.append(round(float(sampler.row(tick / 100)[1][0]), 3))
    assert seen == [NEAR_M] * 3 + [FAR_M] * 10


def test_cut_ahead_shows_at_its_own_frame(playback: Playback) -> None:
    playback.advance(0.26)
    playback.announce_plan(2, 3)
    assert playback.note_cut(8) == 8
    assert playback.cut_before(12) == 8


def test_cut_already_shown_stays_when_a_late_plan_begins_before_it(playback: Playback) -> None:
    playback.announce_plan(2, 3, is_cut=True)
    playback.add_chunk(2, 3, synthetic_rows(FAR_M, 3, 9), 0)
    playback.advance(0.26)
    playback.announce_plan(3, 2)
    assert playback.cut_before(12) == 3, "frames 2 and 3 stay as they were shown, one on each side of it"


def test_fade_ends_at_a_cut_between_two_samples(stick_rig: Rig, playback: Playback) -> None:
    sampler = Sampler(stick_rig, playback, blend_s=1.0)
    sampler.row(0.0)
    playback.advance(0.02)
    sampler.row(0.02)
    playback.announce_plan(2, 1)
    playback.add_chunk(2, 1, synthetic_rows(5, 1, 2), 0)
    playback.announce_plan(3, 3, is_cut=True)
    playback.add_chunk(3, 3, synthetic_rows(FAR_M, 3, 9), 0)
    sampler.row(0.02)
    assert sampler.is_fading
    playback.advance(0.22)  # at 4, with nothing drawn since 0
    assert sampler.row(0.22)[1][0] == pytest.approx(FAR_M)
    assert not sampler.is_fading


def test_cut_is_known_until_it_was_sampled(stick_rig: Rig) -> None:
    playback = Playback(stick_rig.frame_rate_hz, stick_rig.row_width, keep_frames=0)
    sampler = Sampler(stick_rig, playback)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, synthetic_rows(NEAR_M, 0, 2), 0)
    playback.advance(0.0)
    playback.announce_plan(2, 2, is_cut=True)
    playback.advance(0.06)
    sampler.row(0.06)
    playback.add_chunk(2, 2, synthetic_rows(FAR_M, 2, 9), 0)
    playback.advance(0.11)  # as for a report; then a plan comes before the next frame is drawn
    playback.announce_plan(3, 11)
    assert sampler.row(0.11)[1][0] == pytest.approx(FAR_M)


async def test_passed_cut_is_sent_again_if_the_session_is_then_reopened() -> None:
    line = Line()
    session = await open_session(line)
    for update in frames(1):
        session.hear(update)
    session.teleport(5.0, 0.0)
    session.interrupt()
    session.playback.advance_to(7)  # by the application, while disconnected
    session.reattach(convert.catalog(catalog(100)))
    session.hear(opened())
    plan = session_pb2.PlanNotice(plan=2, valid_from=4, cause=session_pb2.PLAN_CAUSE_RESUME, event_seqs=[2])
    session.hear(session_pb2.SessionUpdate(session=1, plan=plan))
    session.hear(answer(2, effective_frame=4))
    assert session.playback.is_cut(8)
    open_anew(session, line)  # before any frame after the cut has come
    assert line.said[-1].seek.start_pose.x == 5.0
