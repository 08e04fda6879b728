"""Prompts with start and end frames, and constraints: which windows get them."""

import numpy as np
import pytest

from motiongen_server.engine.types import JointTargets, Keyframe, PlanCause, RootTrajectory, Waypoint
from tests.server.engine.fakes import CONSTRAINTS
from tests.server.engine.session.playing import markers, playing, start_job, waypoint
from tests.server.engine.stage import Stage, prompt

# ---- prompts in time -------------------------------------------------------------------------------------------------


def test_window_is_cut_at_the_next_prompt_and_the_next_one_starts_there() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1, 1, 0), prompt(2, 2, 50)))
    stage.run(4.0)
    assert [notice.valid_from for notice in viewer.notices][:3] == [0, 40, 50]
    assert markers(viewer, 0, 50) == {1}
    assert markers(viewer, 50, 80) == {2}


def test_a_prompt_beyond_the_plan_needs_no_replan() -> None:
    stage, viewer = playing()
    planned = stage.engine.sessions[viewer.key].planned_to
    seq = stage.set_prompts(viewer, prompt(2, 2, planned + 15))
    stage.run(0.01)
    assert viewer.outcomes[seq].effective_frame == planned + 15
    stage.run(5.0)
    assert {notice.cause for notice in viewer.notices} == {PlanCause.CONTINUE}
    assert markers(viewer, 0, planned + 15) == {1}
    assert markers(viewer, planned + 15, viewer.buffered_to) == {2}


@pytest.mark.parametrize("offset", [-3, -1, 0, 1])
def test_prompt_near_the_end_of_the_plan_starts_at_its_frame(offset: int) -> None:
    stage, viewer = playing()
    start = stage.engine.sessions[viewer.key].planned_to + offset
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(5.0)
    assert viewer.outcomes[seq].effective_frame == start
    assert (markers(viewer, 0, start), markers(viewer, start, viewer.buffered_to)) == ({1}, {2})


def test_prompt_inside_the_plan_replaces_it_from_its_start_frame() -> None:
    stage, viewer = playing()
    start = viewer.shown + 15
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(0.2)
    assert viewer.outcomes[seq].effective_frame == viewer.notices[-1].valid_from == start
    assert markers(viewer, 0, start) == {1}


def test_a_prompt_that_starts_inside_the_running_window_only_cuts_it() -> None:
    stage, viewer = playing()
    start_job(stage, steps=1)
    (running,) = stage.runner.jobs
    start = stage.runner.jobs[running].first_frame + 12
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(2.0)
    assert running in stage.runner.decoded
    assert viewer.outcomes[seq].effective_frame == start
    assert start in {notice.valid_from for notice in viewer.notices}
    assert (markers(viewer, 0, start), markers(viewer, start, viewer.buffered_to)) == ({1}, {2})


def test_prompt_that_has_ended_is_neither_in_force_nor_known() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1, 1, 0, 30),))
    stage.run(3.0)
    assert (markers(viewer, 0, 30), markers(viewer, 30, 60)) == ({1}, {-1})
    seq = stage.set_prompts(viewer, remove=(1,))
    stage.run(0.1)
    assert viewer.outcomes[seq].reason == "UNKNOWN_PROMPT"


def test_a_prompt_change_within_the_first_patch_waits_for_a_history() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1, 1, 0), prompt(2, 2, 2)))
    stage.run(2.0)
    assert (markers(viewer, 0, 4), markers(viewer, 4, 30)) == ({1}, {2})
    stage.check_finished()


def test_earlier_prompt_stays_in_force_up_to_the_effective_frame_of_a_new_one() -> None:
    stage, viewer = playing()
    stage.silent.add(viewer.key)
    viewer.set_paused(True, stage.clock.now())  # it stands still, and the engine was not told
    stage.run(0.5)
    later = stage.set_prompts(viewer, prompt(2))  # counts from beyond where the client was thought to be
    stage.report(viewer)
    sooner = stage.set_constraints(viewer, waypoint(viewer.shown + 40))  # counts from beyond where the client is
    stage.run(0.3)
    begins_at, effective = viewer.notices[-2].valid_from, viewer.outcomes[later].effective_frame
    assert begins_at == viewer.outcomes[sooner].effective_frame
    assert effective is not None
    assert begins_at < effective, "a window was made before the frame that the prompt counts from"
    stage.run(1.0)
    assert markers(viewer, 0, effective) == {1}
    assert markers(viewer, effective, viewer.buffered_to) == {2}
    stage.check_finished()


# ---- constraints -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "target",
    [
        Waypoint(1, 70, 1.0, 2.0, 0.5),
        RootTrajectory(1, 65, np.zeros((20, 2), np.float32)),
        JointTargets(1, 70, (0,), np.zeros((1, 3), np.float32)),
        Keyframe(1, 70, np.zeros((1, 3), np.float32)),
    ],
)
def test_a_constraint_within_reach_replans_at_once(target: Waypoint | RootTrajectory | JointTargets | Keyframe) -> None:
    stage, viewer = playing()
    seq = stage.set_constraints(viewer, target)
    stage.run(0.2)
    assert viewer.notices[-1].event_seqs == (seq,)
    assert stage.runner.prepared[-1].constraints == (target,)


def test_a_constraint_out_of_reach_waits_until_a_window_sees_it() -> None:
    stage, viewer = playing()
    seq = stage.set_constraints(viewer, waypoint(600))
    stage.run(0.1)
    assert viewer.outcomes[seq].effective_frame is not None
    assert {notice.cause for notice in viewer.notices} == {PlanCause.CONTINUE}
    stage.run(35.0)
    sees = {job.first_frame for job in stage.runner.prepared if job.constraints}
    assert min(sees) == min(job.first_frame for job in stage.runner.prepared if job.first_frame - 16 + 200 > 600)
    assert max(sees) <= 600


def test_removing_a_constraint_replans_without_it() -> None:
    stage, viewer = playing(constraints=(waypoint(70),))
    seq = stage.set_constraints(viewer, remove=(1,))
    stage.run(0.2)
    assert viewer.notices[-1].event_seqs == (seq,)
    assert viewer.rows[-1][CONSTRAINTS] == 0
