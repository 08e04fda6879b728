"""A session that is taken back to a frame of its own, and which frames those may be."""

from __future__ import annotations

import re

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.levels import FULL, Level
from motiongen_server.engine.session.cutting import own_frames
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import Code, Outcome, PlanCause, ServiceTier, StartPose, WindowJob
from tests.server.engine.fakes import FRAME
from tests.server.engine.session.playing import playing_state
from tests.server.engine.stage import Stage
from tests.server.engine.viewer import Viewer

KEPT = EngineConfig(rewind_s=3.0)
FAR = 10**6


def cuts(stage: Stage) -> list[WindowJob]:
    return [job for job in stage.runner.prepared if job.cause is PlanCause.CUT]


def gone_back(stage: Stage, viewer: Viewer, frame: int) -> Outcome:
    seq = stage.seek(viewer, frame=frame)
    stage.run_until(lambda: seq in viewer.outcomes)
    return viewer.outcomes[seq]


def allowed(stage: Stage, viewer: Viewer) -> list[tuple[int, int]]:
    """The frames that a refusal names, as ranges."""
    refused = gone_back(stage, viewer, FAR)
    assert (refused.code, refused.reason, refused.field) == (
        Code.FAILED_PRECONDITION,
        "FRAME_NOT_HELD",
        "seek.frame",
    )
    return [(int(low), int(high)) for low, high in re.findall(r"(\d+) to (\d+)", refused.allowed)]


def later(config: EngineConfig = KEPT) -> tuple[Stage, Viewer, SessionState]:
    stage, viewer, state = playing_state(config)
    stage.run(6.0)
    return stage, viewer, state


def test_seek_to_a_frame_continues_from_the_frames_before_it() -> None:
    stage, viewer, state = later()
    frame = state.clock.reported - 30
    outcome = gone_back(stage, viewer, frame)
    stage.run(3.0)
    (cut,) = cuts(stage)
    assert outcome.code is Code.OK
    assert outcome.effective_frame == cut.first_frame > frame
    assert cut.start_pose is None
    np.testing.assert_array_equal(cut.history[:, 0], np.arange(frame - 16, frame))
    following = stage.runner.prepared[stage.runner.prepared.index(cut) + 1]
    assert following.history[0, 0] >= cut.first_frame, "later windows continue from the frames made"
    stage.check_finished()


def test_same_frame_can_be_sought_repeatedly_even_after_a_cut() -> None:
    stage, viewer, state = later()
    frame = state.clock.reported - 10
    for number in range(1, 4):
        assert gone_back(stage, viewer, frame).code is Code.OK
        cut = cuts(stage)[-1]
        assert len(cuts(stage)) == number
        np.testing.assert_array_equal(cut.history[:, 0], np.arange(frame - 16, frame))
    before, last = cuts(stage)[0].first_frame, cuts(stage)[-1].first_frame
    spans = allowed(stage, viewer)
    assert spans[0][1] == before, "up to the frame at which the first cut came"
    assert spans[-1] == (last + 4, state.delivery.sent_to)


def test_no_history_spans_a_cut() -> None:
    stage, viewer, state = later()
    seq = stage.seek(viewer, StartPose(5.0, 5.0, 0.0))
    stage.run_until(lambda: seq in viewer.outcomes)
    cut = cuts(stage)[-1].first_frame
    stage.run_until(lambda: state.delivery.sent_to >= cut + 10)
    assert gone_back(stage, viewer, cut + 2).reason == "FRAME_NOT_HELD"
    assert gone_back(stage, viewer, cut + 9).code is Code.OK
    np.testing.assert_array_equal(cuts(stage)[-1].history[:, 0], np.arange(cut + 1, cut + 9))


def test_frames_kept_for_seeking_follow_rewind_s() -> None:
    for rewind_s in (0.0, 1.0, 3.0):
        stage, viewer, state = later(EngineConfig(rewind_s=rewind_s))
        ((low, high),) = allowed(stage, viewer)
        kept = state.clock.reported - low
        assert 20 * rewind_s <= kept <= 20 * rewind_s + 40 + 16
        assert high == state.delivery.sent_to
        assert gone_back(stage, viewer, low).code is Code.OK
        assert gone_back(stage, viewer, low - 1).reason == "FRAME_NOT_HELD"


def test_seek_before_the_first_frame_was_sent_is_refused() -> None:
    stage = Stage(KEPT)
    viewer = stage.open()
    seq = stage.seek(viewer, frame=1)
    stage.run(1.0)
    refused = viewer.outcomes[seq]
    assert (refused.reason, refused.allowed) == ("FRAME_NOT_HELD", "a frame once 4 frames before it were sent")


def test_timeline_knows_where_held_poses_end_and_motion_begins() -> None:
    timeline = later()[2].timeline
    held = timeline.held(8)
    assert held.held_to == held.end == timeline.end + 8
    assert held.stretches == ((held.motion_from if held.motion_from > held.first else held.first, held.end),)
    assert held.spliced(held.end, timeline.rows[:4], timeline.features[:4]).held_to == held.end


def test_frames_of_a_held_pose_and_those_before_it_are_not_gone_back_to() -> None:
    """The histories held there are of other frames: the motion before the pose was moved to its end."""
    stage, viewer, state = later()
    stage.runner.holds = True
    state.set_tier(Level(ServiceTier.HOLD, hold=True))
    stage.engine.sessions.touch(state)
    stage.run_until(lambda: state.holding)
    stood_from = state.timeline.held_to - state.config.hold_frames
    state.set_tier(FULL)
    stage.engine.sessions.touch(state)
    stage.run_until(lambda: state.delivery.sent_to > state.timeline.held_to + 8)
    assert state.timeline.motion_from + 4 < stood_from, "without the pose, one could go back to before it"
    moves_from = state.timeline.held_to
    for frame in (stood_from - 1, stood_from + 4, moves_from - 1):
        assert gone_back(stage, viewer, frame).reason == "FRAME_NOT_HELD"
    ((low, _),) = allowed(stage, viewer)
    assert low == moves_from
    assert gone_back(stage, viewer, moves_from + 8).code is Code.OK
    history = cuts(stage)[-1].history[:, 0]
    np.testing.assert_array_equal(history[-8:], np.arange(moves_from, moves_from + 8))
    np.testing.assert_array_equal(history[:-8], np.arange(stood_from - 8, stood_from))


def test_own_frames_are_whole_patches_up_to_the_history_and_at_least_one() -> None:
    _, _, state = later()
    end, patch = state.delivery.sent_to, state.facts.patch
    for most, length in ((0, patch), (patch - 1, patch), (4 * patch, 4 * patch), (4 * patch + 1, 4 * patch)):
        rows, features = own_frames(state.timeline, end, end, most, patch)
        assert (len(rows), len(features)) == (length, length)
        np.testing.assert_array_equal(rows[:, FRAME], np.arange(end - length, end))


def test_frames_after_the_reported_playhead_are_kept_though_committed() -> None:
    stage, _, state = playing_state(EngineConfig(rewind_s=0.0, margin_s=0.7))
    farthest = 0
    for _ in range(200):
        stage.run(0.05)
        assert state.timeline.first <= max(0, state.clock.reported - state.config.history_crop)
        farthest = max(farthest, state.delivery.committed_to - state.clock.reported)
    assert farthest > 10
    assert state.timeline.first > 0
