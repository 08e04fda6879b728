"""Cuts: the character is elsewhere from the first frame that can still change, and nothing goes on across that."""

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Code, PlanCause, SnapshotTaken, StartPose, Waypoint
from tests.server.engine.fakes import FEATURE_DIM, FRAME, ROW_WIDTH
from tests.server.engine.session.playing import playing, start_job
from tests.server.engine.stage import Stage

THERE = StartPose(7.0, -2.0, 1.0)


def test_it_stands_elsewhere_from_the_plan_that_says_so() -> None:
    stage, viewer = playing()
    before = len(stage.runner.prepared)
    seq = stage.seek(viewer, THERE)
    stage.run(4.0)
    cut, *later = stage.runner.prepared[before:]
    assert (cut.cause, cut.start_pose, len(cut.history)) == (PlanCause.CUT, THERE, 0)
    notice = next(notice for notice in viewer.notices if notice.cause is PlanCause.CUT)
    assert notice.event_seqs == (seq,)
    assert notice.valid_from == cut.first_frame == viewer.outcomes[seq].effective_frame
    assert later
    assert all(job.start_pose is None and job.cause is PlanCause.CONTINUE for job in later)
    stage.check_finished()


def test_it_goes_on_from_frames_that_are_given() -> None:
    stage, viewer = playing()
    rows = np.zeros((8, ROW_WIDTH), np.float32)
    rows[:, FRAME] = 500.0
    rows[:, 3] = 1.0  # a quaternion
    before = len(stage.runner.prepared)
    stage.seek(viewer, prior_rows=rows)
    stage.run(4.0)
    cut, following = stage.runner.prepared[before : before + 2]
    assert (cut.start_pose, len(cut.history)) == (None, 8)
    assert np.all(cut.history == np.full((8, FEATURE_DIM), 500.0))
    assert not np.any(following.history == 500.0), "later windows go on from what was made"
    assert len(following.history) <= following.first_frame - cut.first_frame
    assert stage.runner.breaches == [f"history before {cut.first_frame} is not contiguous"]


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_it_waits_for_no_window_to_be_lost(steps: int) -> None:
    stage, viewer = playing()
    if steps:
        start_job(stage, steps)
    seq = stage.seek(viewer, THERE)
    stage.run(3.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert [job.start_pose for job in stage.runner.prepared if job.cause is PlanCause.CUT][-1] == THERE
    assert sum(notice.cause is PlanCause.CUT for notice in viewer.notices) == 1
    stage.check_finished()


def test_one_that_came_too_late_is_tried_again() -> None:
    stage, viewer = playing()
    stage.runner.step_s = lambda rows: 0.12
    stage.seek(viewer, THERE)
    stage.run(6.0)
    cuts = [job for job in stage.runner.prepared if job.cause is PlanCause.CUT]
    assert len(cuts) >= 1
    assert sum(notice.cause is PlanCause.CUT for notice in viewer.notices) == 1


def test_what_is_asked_from_the_character_is_seen_from_where_it_is_after_it() -> None:
    stage, viewer = playing()
    stage.seek(viewer, THERE)
    stage.run(1.0)
    job = next(job for job in stage.runner.prepared if job.cause is PlanCause.CUT)
    stage.set_velocity(viewer, 0.0, 1.0)
    stage.run(0.5)
    led = stage.runner.prepared[-1]
    (path,) = led.constraints
    # The fake model walks on along +X as it did; the speed is not that of a jump across the cut.
    assert not isinstance(path, Waypoint)
    assert led.first_frame > job.first_frame
    assert np.hypot(*np.diff(path.xz[:2], axis=0)[0]) < 0.2  # type: ignore[union-attr]


def test_a_session_may_be_cut_before_its_first_frame() -> None:
    stage = Stage()
    viewer = stage.open()
    seq = stage.seek(viewer, THERE)
    stage.run(2.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert any(job.start_pose == THERE for job in stage.runner.prepared)
    stage.check_finished()


def test_frames_that_the_model_cannot_read_are_refused() -> None:
    stage, viewer = playing()
    stage.runner.fails = lambda call, job_ids: call == "features"
    seq = stage.seek(viewer, prior_rows=np.zeros((8, ROW_WIDTH), np.float32))
    stage.run(0.5)
    assert (viewer.outcomes[seq].reason, viewer.outcomes[seq].field) == ("PRIOR_FRAMES_FAILED", "seek.prior_frames")


def test_no_snapshot_is_taken_while_a_cut_waits() -> None:
    stage, viewer = playing(EngineConfig(snapshots=True))
    seq = stage.seek(viewer, THERE)
    told = len(stage.outputs)
    stage.run(3.0)
    taken = [each for each in stage.outputs[told:] if isinstance(each, SnapshotTaken)]
    assert taken
    for each in taken:
        before = each.snapshot.last_seq < seq
        assert before or each.snapshot.end_frame > (viewer.outcomes[seq].effective_frame or 0)
