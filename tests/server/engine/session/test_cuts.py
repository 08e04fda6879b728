"""Cuts: the character is put elsewhere at the first frame that can still change, and nothing continues across it."""

import math

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import (
    Code,
    PlanCause,
    Priority,
    RootPath,
    RootTrajectory,
    SnapshotTaken,
    StartPose,
    Unplaced,
    Waypoint,
    WindowJob,
)
from tests.server.engine.fakes import FACTS, FEATURE_DIM, FRAME, ROW_WIDTH
from tests.server.engine.session.playing import playing, playing_state, start_job
from tests.server.engine.stage import Stage, prompt

THERE = StartPose(7.0, -2.0, 1.0)


def test_cut_puts_the_character_elsewhere_from_its_plan_on() -> None:
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


def test_cut_with_prior_frames_continues_from_them() -> None:
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
    assert not np.any(following.history == 500.0), "later windows continue from the frames made"
    assert len(following.history) <= following.first_frame - cut.first_frame
    assert stage.runner.breaches == [f"history before {cut.first_frame} is not contiguous"]


@pytest.mark.parametrize(("done", "more"), [(0, 4), (1, 4), (2, 6), (3, 5)])
def test_cut_replaces_a_running_window_in_its_first_half_and_follows_it_otherwise(done: int, more: int) -> None:
    """done: steps of the running window when the cut comes; more: steps from then on until the cut's plan is told."""
    stage, viewer, state = playing_state()
    if done:
        start_job(stage, done)
    asked_at, floor = stage.clock.now(), state.replaceable_from(stage.clock.now(), state.delivery.commit_s)
    seq = stage.seek(viewer, THERE)
    stage.run_until(lambda: seq in viewer.outcomes)
    assert stage.clock.now() - asked_at == pytest.approx(0.01 * more)
    frame = viewer.outcomes[seq].effective_frame
    assert frame is not None
    assert floor < frame <= floor + math.ceil(0.01 * more * FACTS.fps), "at the first frame that can still change then"
    stage.run(3.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert [job.start_pose for job in stage.runner.prepared if job.cause is PlanCause.CUT] == [THERE]
    assert sum(notice.cause is PlanCause.CUT for notice in viewer.notices) == 1
    stage.check_finished()


def test_cut_whose_window_came_too_late_is_made_again_further_on() -> None:
    stage, viewer = playing()
    stage.runner.step_s = lambda rows: 0.12
    seq = stage.seek(viewer, THERE)
    stage.run(6.0)
    assert stage.total("windows_discarded") == 1
    late, again = (job for job in stage.runner.prepared if job.cause is PlanCause.CUT)
    assert again.start_pose == late.start_pose == THERE
    assert again.first_frame > late.first_frame
    (notice,) = (notice for notice in viewer.notices if notice.cause is PlanCause.CUT)
    assert (notice.valid_from, notice.event_seqs) == (again.first_frame, (seq,))
    stage.check_finished()


def test_cut_for_a_client_at_the_end_of_the_plan_is_named_by_its_notice() -> None:
    stage, viewer, state = playing_state()
    stage.run_until(lambda: viewer.buffered_to == state.planned_to)
    end = state.planned_to
    stage.engine.submit(viewer.lie(end - 1, stage.clock.now()))
    seq = stage.seek(viewer, THERE)
    stage.run(3.0)
    (notice,) = (notice for notice in viewer.notices if notice.cause is PlanCause.CUT)
    assert (notice.valid_from, notice.event_seqs) == (end, (seq,))
    assert viewer.outcomes[seq].effective_frame == end
    stage.check_finished()


def test_velocity_after_a_cut_does_not_take_the_jump_for_speed() -> None:
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


def ahead(constraint_id: int, metres: float = 2.0) -> Unplaced:
    """A root path of so many metres straight ahead of the character."""
    corner = np.array([[0.0, metres]], np.float32)
    return Unplaced(RootPath(constraint_id, corner, 1.2, 0.3), is_relative=True)


@pytest.mark.parametrize("after_s", [0.0, 0.005, 0.1, 0.2])
def test_relative_path_after_a_cut_starts_where_the_cut_puts_the_character(after_s: float) -> None:
    """Both if one plan answers the two events, and if the cut's plan is still being made when the second comes."""
    stage, viewer = playing(priority=Priority.HERO)
    stage.runner.step_s = lambda rows: 0.05
    cut = [0]

    def stand_there(job: WindowJob, frames: np.ndarray) -> None:
        if job.start_pose == THERE:
            cut[0] = job.plan
        if cut[0] and job.plan >= cut[0]:
            frames[:, :3] = THERE.x, 0.0, THERE.z

    stage.runner.moves = stand_there
    stage.run(1.0)
    before = stage.set_constraints(viewer, ahead(1))
    stage.seek(viewer, THERE)
    stage.run(after_s)
    behind = stage.set_constraints(viewer, ahead(2))
    stage.run_until(lambda: behind in viewer.outcomes)
    (seen_before,), (seen_behind,) = (viewer.outcomes[seq].placements for seq in (before, behind))
    assert abs(seen_before.x - THERE.x) > 4.0
    assert (seen_behind.x, seen_behind.z) == pytest.approx((THERE.x, THERE.z))
    told = {seq: notice.valid_from for notice in viewer.notices for seq in notice.event_seqs}
    assert (seen_before.anchor_frame, seen_behind.anchor_frame) == (told[before], told[behind])
    held = {item.constraint_id: item for item in stage.engine.sessions[viewer.key].conditions.constraints}
    assert isinstance(held[2], RootTrajectory)
    assert np.hypot(*(held[2].xz[-1] - held[2].xz[0])) == pytest.approx(2.0, abs=0.1)


def test_relative_path_between_two_cuts_starts_where_the_first_one_leads() -> None:
    stage, viewer = playing()
    seqs = []
    for number, x in enumerate((20.0, 30.0), 1):
        stage.seek(viewer, StartPose(x, 0.0, 0.0))
        seqs.append(stage.set_constraints(viewer, ahead(number)))
    stage.run(1.0)
    assert [viewer.outcomes[seq].placements[0].x for seq in seqs] == [20.0, 30.0]
    assert sum(notice.cause is PlanCause.CUT for notice in viewer.notices) == 1


def test_cut_before_the_first_frame_is_accepted_and_made() -> None:
    stage = Stage()
    viewer = stage.open()
    seq = stage.seek(viewer, THERE)
    stage.run(2.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert any(job.start_pose == THERE for job in stage.runner.prepared)
    stage.check_finished()


def test_cut_with_prior_frames_that_the_runner_cannot_convert_is_refused() -> None:
    stage, viewer = playing()
    stage.runner.fails = lambda call, job_ids: call == "features"
    seq = stage.seek(viewer, prior_rows=np.zeros((8, ROW_WIDTH), np.float32))
    stage.run(0.5)
    assert (viewer.outcomes[seq].reason, viewer.outcomes[seq].field) == ("PRIOR_FRAMES_FAILED", "seek.prior_frames")


@pytest.mark.parametrize("begun", [False, True])
def test_no_snapshot_is_taken_until_a_cut_has_its_frames(begun: bool) -> None:
    """begun: the cut's window runs. The answer to the pause would be saved at once otherwise."""
    stage, viewer, state = playing_state(EngineConfig(snapshots=True))
    if not begun:
        state.edits.wait_until(stage.clock.now() + 1.0)
    told = len(stage.outputs)
    seq = stage.seek(viewer, THERE)
    stage.step()
    assert (state.running is not None) is begun
    paused = stage.pause(viewer, True)
    stage.step()
    assert paused in viewer.outcomes
    assert seq not in viewer.outcomes
    assert not [each for each in stage.outputs[told:] if isinstance(each, SnapshotTaken)]
    stage.run_until(lambda: seq in viewer.outcomes)
    stage.step()
    taken = [each.snapshot for each in stage.outputs[told:] if isinstance(each, SnapshotTaken)]
    assert [(each.plan, each.last_seq) for each in taken] == [(viewer.notices[-1].plan, paused)]
    assert taken[0].end_frame == (viewer.outcomes[seq].effective_frame or 0) + FACTS.horizon


@pytest.mark.parametrize("slow_s", [0.03, 0.15, 0.3])
def test_cut_joins_a_window_that_waits_to_begin(slow_s: float) -> None:
    """A slow step of another session delays the window, also for the prompt that had joined it."""
    stage = Stage()
    stage.runner.step_s = lambda rows: 0.03
    viewer, other = (stage.open(number, priority=Priority.HERO, prompts=(prompt(1),)) for number in (1, 2))
    stage.run(3.0)
    stage.set_prompts(other, prompt(5))
    stage.run_until(lambda: bool(stage.runner.jobs))
    stage.set_prompts(viewer, prompt(2))
    stage.runner.step_s = lambda rows: slow_s
    stage.step()
    stage.runner.step_s = lambda rows: 0.03
    stage.set_prompts(viewer, prompt(3))
    seq = stage.seek(viewer, THERE)
    stage.run(4.0)
    (notice,) = (notice for notice in viewer.notices if notice.cause is PlanCause.CUT)
    assert seq in notice.event_seqs
    assert [job.first_frame for job in stage.runner.prepared if job.start_pose == THERE] == [notice.valid_from]


@pytest.mark.parametrize("paused", [True, False])
def test_cuts_in_quick_succession_replace_one_another(paused: bool) -> None:
    """As when a slider is dragged: each cut is to be seen at once, before the frames of the one before are played."""
    stage, viewer = playing(EngineConfig(rewind_s=2.0))
    stage.run(2.0)
    if paused:
        stage.pause(viewer, True)
        stage.run(0.3)
    for number in range(50):
        seq = stage.seek(viewer, StartPose(float(number), 0.0, 0.0))
        stage.run(0.1)
    stage.run_until(lambda: seq in viewer.outcomes)
    frame = viewer.outcomes[seq].effective_frame
    assert frame is not None
    assert frame - viewer.shown <= 12, "as soon after the playhead as the first cut"
    assert stage.runner.prepared[-1].start_pose == StartPose(49.0, 0.0, 0.0)
    assert len(stage.engine.sessions[viewer.key].timeline.rows) <= 150
