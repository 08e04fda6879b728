"""The rules of a session, one by one, seen by a viewer that checks what must always hold."""

import itertools

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Code, JointTargets, Keyframe, PlanCause, RootTrajectory, StartPose, Waypoint
from tests.server.engine.fakes import CONSTRAINTS, PLAN, PROMPT
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer


def _markers(viewer: Viewer, begin: int, end: int) -> set[int]:
    return {int(row[PROMPT]) for row in viewer.rows[begin:end]}


# when the viewer of `_playing` begins to play: after four steps
PLAYS_FROM = 100.04


def _waypoint(frame: int, constraint_id: int = 1) -> Waypoint:
    return Waypoint(constraint_id, frame, 1.0, 2.0)


def _playing(config: EngineConfig | None = None, **fields: object) -> tuple[Stage, Viewer]:
    """A stage whose one session has played for a second; 4 steps a window, 10 ms a step."""
    stage = Stage(config)
    viewer = stage.open(prompts=(prompt(1),), **fields)
    stage.run(1.0)
    return stage, viewer


def _start_job(stage: Stage, steps: int) -> None:
    """Let a continuation start and do some of its four steps."""
    before = len(stage.runner.prepared)
    stage.run_until(lambda: len(stage.runner.prepared) > before)
    (job_id,) = stage.runner.jobs
    stage.run_until(lambda: stage.runner.steps[job_id] >= steps)


# ---- opening, continuing, credit -------------------------------------------------------------------------------------


def test_opening_gives_the_session_and_then_its_first_plan() -> None:
    stage = Stage()
    viewer = stage.open(seed=77, prompts=(prompt(5),))
    stage.run(0.2)
    assert viewer.opened is not None
    assert (viewer.opened.seed, viewer.opened.start_frame, viewer.opened.committed_horizon) == (77, 0, 5)
    (notice,) = viewer.notices
    assert (notice.plan, notice.valid_from, notice.cause, notice.event_seqs) == (1, 0, PlanCause.CONTINUE, ())
    assert [len(chunk.rows) for chunk in viewer.chunks] == [8, 20, 12]
    assert _markers(viewer, 0, 40) == {5}
    (job,) = stage.runner.prepared
    assert (job.seed, job.plan, job.num_steps, job.start_pose) == (77, 1, 4, StartPose())
    assert job.deadline == pytest.approx(100.0 + EngineConfig().open_target_s)


def test_motion_goes_on_without_a_gap() -> None:
    stage, viewer = _playing()
    stage.run(30.0)
    assert viewer.underruns == 0
    assert viewer.shown == pytest.approx(31 * 20, abs=3)
    assert {notice.cause for notice in viewer.notices} == {PlanCause.CONTINUE}
    assert [notice.valid_from for notice in viewer.notices] == [40 * n for n in range(len(viewer.notices))]
    stage.check_finished()


def test_steady_chunks_are_not_long() -> None:
    stage = Stage()
    viewer = stage.open(lookahead=80)
    stage.run(20.0)
    assert max(len(chunk.rows) for chunk in viewer.chunks) == 20


def test_without_a_playhead_one_lookahead_is_sent_and_then_nothing_is_computed() -> None:
    stage = Stage()
    viewer = stage.open(lookahead=30)
    stage.silent.add(viewer.key)
    stage.run(60.0)
    assert viewer.buffered_to == 30
    assert len(stage.runner.prepared) == 1


def test_a_client_that_falls_silent_stops_the_generation() -> None:
    stage, viewer = _playing()
    stage.silent.add(viewer.key)
    stage.run(10.0)
    windows = len(stage.runner.prepared)
    assert viewer.buffered_to == viewer.reported + viewer.lookahead
    stage.run(60.0)
    assert len(stage.runner.prepared) == windows
    stage.silent.clear()
    stage.run(10.0)
    assert viewer.buffered_to > viewer.shown + 20


def test_a_longer_lookahead_is_filled() -> None:
    stage, viewer = _playing(lookahead=80)
    stage.run(20.0)
    stage.report(viewer)
    stage.run(0.1)
    assert viewer.buffered_to - viewer.shown > 35


def test_old_frames_and_passed_conditions_are_let_go() -> None:
    stage, viewer = _playing()
    state = stage.engine._sessions[viewer.key]
    for n in range(100):
        frame = viewer.buffered_to + 10
        stage.set_constraints(viewer, _waypoint(frame, constraint_id=n))
        stage.set_prompts(viewer, prompt(n, prompt_id=n + 2, start=frame, end=frame + 5))
        stage.run(1.0)
        assert len(state.timeline.rows) <= 160
        assert len(state.conditions.constraints) < 10
        assert len(state.conditions.prompts) < 10
        assert len(state.edits.unseen) < 10


# ---- edits -----------------------------------------------------------------------------------------------------------


def test_a_prompt_replaces_frames_soon_but_none_that_was_played() -> None:
    stage, viewer = _playing()
    shown = viewer.shown
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(0.1)
    outcome = viewer.outcomes[seq]
    assert outcome.code is Code.OK
    assert outcome.effective_frame is not None
    assert shown + 4 <= outcome.effective_frame <= shown + 10
    notice = viewer.notices[-1]
    assert (notice.valid_from, notice.cause) == (outcome.effective_frame, PlanCause.EDIT)
    assert notice.event_seqs == (seq,)
    assert _markers(viewer, 0, outcome.effective_frame) == {1}
    assert _markers(viewer, outcome.effective_frame, viewer.buffered_to) == {2}
    assert next(len(chunk.rows) for chunk in viewer.chunks if chunk.plan == notice.plan) == 8


def test_the_notice_comes_before_the_outcome_and_both_before_the_frames() -> None:
    stage, viewer = _playing()
    before = len(stage.outputs)
    stage.set_prompts(viewer, prompt(2))
    stage.run(0.1)
    assert [type(output).__name__ for output in stage.outputs[before:]][:3] == ["PlanNotice", "Outcome", "Chunk"]


def test_several_edits_make_one_replan_and_each_has_its_outcome() -> None:
    stage, viewer = _playing()
    plans = len(viewer.notices)
    seqs = [
        stage.set_prompts(viewer, prompt(2)),
        stage.set_constraints(viewer, _waypoint(60)),
        stage.set_prompts(viewer, prompt(3)),
    ]
    stage.run(0.1)
    assert len(viewer.notices) == plans + 1
    assert viewer.notices[-1].event_seqs == tuple(seqs)
    assert len({viewer.outcomes[seq].effective_frame for seq in seqs}) == 1
    assert viewer.rows[-1][PROMPT] == 3
    assert viewer.rows[-1][CONSTRAINTS] == 1


def test_edits_before_the_first_frame_hold_from_frame_0() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1),))
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(0.2)
    assert viewer.outcomes[seq].effective_frame == 0
    assert _markers(viewer, 0, 40) == {2}
    assert stage.runner.prepared[0].start_pose is not None


def test_an_edit_early_in_a_running_window_restarts_it() -> None:
    stage, viewer = _playing()
    _start_job(stage, steps=1)
    (running,) = stage.runner.jobs
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(0.2)
    assert running in stage.runner.discarded
    assert stage.total("windows_restarted") == 1
    assert viewer.notices[-1].event_seqs == (seq,)
    assert _markers(viewer, viewer.notices[-1].valid_from, viewer.buffered_to) == {2}


def test_an_edit_late_in_a_running_window_follows_it() -> None:
    stage, viewer = _playing()
    _start_job(stage, steps=2)
    (running,) = stage.runner.jobs
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(0.2)
    assert running in stage.runner.decoded
    assert stage.total("windows_restarted") == 0
    assert [notice.event_seqs for notice in viewer.notices[-2:]] == [(), (seq,)]


def test_edits_without_end_throw_nothing_away_that_was_begun_for_one() -> None:
    stage, viewer = _playing(num_steps=10)
    seqs = []
    for n in range(40):
        seqs.append(stage.set_prompts(viewer, prompt(n)))
        stage.run(0.01)
    plans = [notice for notice in viewer.notices if notice.cause is PlanCause.EDIT]
    assert len(plans) == 2  # of five a second that the class may have
    assert stage.total("windows_restarted") <= EngineConfig().max_restarts
    assert stage.total("steps_discarded") <= 5
    stage.run(1.0)
    assert all(viewer.outcomes[seq].code is Code.OK for seq in seqs)
    assert viewer.rows[-1][PROMPT] == 39
    stage.check_finished()


def test_an_edit_joins_a_window_that_has_not_begun() -> None:
    stage = Stage(EngineConfig(max_rows=1))
    hero, viewer = (stage.open(handle, priority=Priority(handle), prompts=(prompt(1),)) for handle in (1, 2))
    stage.run(1.0)
    stage.set_prompts(hero, prompt(5))
    first = stage.set_prompts(viewer, prompt(2))
    stage.run(0.015)
    second = stage.set_prompts(viewer, prompt(3))
    stage.run(0.3)
    assert [notice.event_seqs for notice in viewer.notices if notice.event_seqs] == [(first, second)]
    assert stage.total("steps_discarded") == stage.total("windows_restarted") == 0
    assert _markers(viewer, viewer.notices[-1].valid_from, viewer.buffered_to) == {3}


def test_an_edit_that_changes_nothing_makes_no_plan() -> None:
    stage, viewer = _playing()
    plans = len(viewer.notices)
    seq = stage.set_prompts(viewer, prompt(1))
    empty = stage.set_constraints(viewer, clear=True)
    stage.run(0.05)
    assert (viewer.outcomes[seq].code, viewer.outcomes[seq].effective_frame) == (Code.OK, None)
    assert (viewer.outcomes[empty].code, viewer.outcomes[empty].effective_frame) == (Code.OK, None)
    assert len(viewer.notices) == plans


def test_a_refused_edit_changes_nothing_and_says_why() -> None:
    stage, viewer = _playing()
    plans = len(viewer.notices)
    seq = stage.set_constraints(viewer, _waypoint(60, 1), _waypoint(3, 2))
    stage.run(0.05)
    outcome = viewer.outcomes[seq]
    assert (outcome.code, outcome.reason) == (Code.FAILED_PRECONDITION, "FRAME_COMMITTED")
    assert (outcome.field, outcome.effective_frame) == ("edit_constraints.upsert[1].frame", None)
    assert len(viewer.notices) == plans
    unknown = stage.set_constraints(viewer, remove=(1,))
    stage.run(0.05)
    assert viewer.outcomes[unknown].reason == "UNKNOWN_CONSTRAINT"


def test_limits_of_a_session_are_enforced() -> None:
    stage, viewer = _playing(EngineConfig(max_prompts=2, max_constraints=2))
    prompts = [stage.set_prompts(viewer, prompt(n, prompt_id=n)) for n in (2, 3)]
    constraints = [stage.set_constraints(viewer, _waypoint(100, n)) for n in (1, 2, 3)]
    stage.run(0.3)
    assert [viewer.outcomes[seq].reason for seq in prompts] == ["", "TOO_MANY_PROMPTS"]
    assert [viewer.outcomes[seq].reason for seq in constraints] == ["", "", "TOO_MANY_CONSTRAINTS"]


# ---- prompts in time -------------------------------------------------------------------------------------------------


def test_a_window_is_taken_up_to_the_next_prompt_and_the_next_one_starts_there() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1, 1, 0), prompt(2, 2, 50)))
    stage.run(4.0)
    assert [notice.valid_from for notice in viewer.notices][:3] == [0, 40, 50]
    assert _markers(viewer, 0, 50) == {1}
    assert _markers(viewer, 50, 80) == {2}


def test_a_prompt_beyond_the_plan_needs_no_replan() -> None:
    stage, viewer = _playing()
    planned = stage.engine._sessions[viewer.key].planned_to
    seq = stage.set_prompts(viewer, prompt(2, 2, planned + 15))
    stage.run(0.01)
    assert viewer.outcomes[seq].effective_frame == planned + 15
    stage.run(5.0)
    assert {notice.cause for notice in viewer.notices} == {PlanCause.CONTINUE}
    assert _markers(viewer, 0, planned + 15) == {1}
    assert _markers(viewer, planned + 15, viewer.buffered_to) == {2}


@pytest.mark.parametrize("offset", [-3, -1, 0, 1])
def test_a_prompt_near_the_end_of_the_plan_starts_where_it_says(offset: int) -> None:
    stage, viewer = _playing()
    start = stage.engine._sessions[viewer.key].planned_to + offset
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(5.0)
    assert viewer.outcomes[seq].effective_frame == start
    assert (_markers(viewer, 0, start), _markers(viewer, start, viewer.buffered_to)) == ({1}, {2})


def test_a_prompt_inside_the_plan_replaces_it_from_there() -> None:
    stage, viewer = _playing()
    start = viewer.shown + 15
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(0.2)
    assert viewer.outcomes[seq].effective_frame == viewer.notices[-1].valid_from == start
    assert _markers(viewer, 0, start) == {1}


def test_a_prompt_that_starts_inside_the_running_window_only_cuts_it() -> None:
    stage, viewer = _playing()
    _start_job(stage, steps=1)
    (running,) = stage.runner.jobs
    start = stage.runner.jobs[running].first_frame + 12
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(2.0)
    assert running in stage.runner.decoded
    assert viewer.outcomes[seq].effective_frame == start
    assert start in {notice.valid_from for notice in viewer.notices}
    assert (_markers(viewer, 0, start), _markers(viewer, start, viewer.buffered_to)) == ({1}, {2})


def test_a_prompt_that_ends_gives_way() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1, 1, 0, 30),))
    stage.run(3.0)
    assert (_markers(viewer, 0, 30), _markers(viewer, 30, 60)) == ({1}, {-1})
    seq = stage.set_prompts(viewer, remove=(1,))
    stage.run(0.1)
    assert viewer.outcomes[seq].reason == "UNKNOWN_PROMPT"


def test_a_prompt_change_within_the_first_patch_waits_for_a_history() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1, 1, 0), prompt(2, 2, 2)))
    stage.run(2.0)
    assert (_markers(viewer, 0, 4), _markers(viewer, 4, 30)) == ({1}, {2})
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
    stage, viewer = _playing()
    seq = stage.set_constraints(viewer, target)
    stage.run(0.2)
    assert viewer.notices[-1].event_seqs == (seq,)
    assert stage.runner.prepared[-1].constraints == (target,)


def test_a_constraint_out_of_reach_waits_until_a_window_sees_it() -> None:
    stage, viewer = _playing()
    seq = stage.set_constraints(viewer, _waypoint(600))
    stage.run(0.1)
    assert viewer.outcomes[seq].effective_frame is not None
    assert {notice.cause for notice in viewer.notices} == {PlanCause.CONTINUE}
    stage.run(35.0)
    sees = {job.first_frame for job in stage.runner.prepared if job.constraints}
    assert min(sees) == min(job.first_frame for job in stage.runner.prepared if job.first_frame - 16 + 200 > 600)
    assert max(sees) <= 600


def test_removing_a_constraint_replans_without_it() -> None:
    stage, viewer = _playing(constraints=(_waypoint(70),))
    seq = stage.set_constraints(viewer, remove=(1,))
    stage.run(0.2)
    assert viewer.notices[-1].event_seqs == (seq,)
    assert viewer.rows[-1][CONSTRAINTS] == 0


# ---- late windows ----------------------------------------------------------------------------------------------------


def test_a_window_that_lands_too_late_is_discarded_and_tried_with_a_longer_lead() -> None:
    stage, viewer = _playing(EngineConfig(continue_threshold=10))
    stage.run_until(lambda: viewer.buffered_to - viewer.shown > 30)
    seq = stage.set_prompts(viewer, prompt(2))
    slow = iter([0.2] * 4)
    stage.runner.step_s = lambda rows: next(slow, 0.01)
    stage.run(2.0)
    assert stage.total("windows_discarded") == 1
    outcome = viewer.outcomes[seq]
    assert outcome.code is Code.OK
    first, second = [job for job in stage.runner.prepared if job.cause is PlanCause.EDIT]
    playhead = (second.created_at - PLAYS_FROM) * 20
    took = second.created_at - first.created_at
    assert second.first_frame - playhead >= took * 20
    assert second.plan == first.plan
    assert _markers(viewer, outcome.effective_frame or 0, viewer.buffered_to) == {2}
    stage.check_finished()


def test_a_promise_made_while_a_window_runs_does_not_void_it() -> None:
    stage = Stage(report_every_s=0.02)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run_until(lambda: len(viewer.notices) == 2)
    stage.runner.step_s = lambda rows: 0.03
    seq = stage.set_prompts(viewer, prompt(2))
    promised = viewer.committed_to
    stage.run_until(lambda: seq in viewer.outcomes)
    assert viewer.committed_to > promised
    assert stage.total("windows_discarded") == 0


def test_an_edit_of_the_first_patch_holds_after_it() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1, 1, 0),))
    seq = stage.set_prompts(viewer, prompt(2, 2, 2))
    stage.run(2.0)
    assert viewer.outcomes[seq].effective_frame == 4
    assert (_markers(viewer, 0, 4), _markers(viewer, 4, 30)) == ({1}, {2})


def test_the_lead_follows_what_windows_take() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1),))
    stage.runner.step_s = lambda rows: 0.1
    stage.run(10.0)
    stage.run_until(lambda: viewer.buffered_to - viewer.shown > 30 and not stage.runner.jobs)
    shown = viewer.shown
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(1.0)
    assert stage.total("windows_discarded") == 0
    assert shown + 0.4 * 20 <= (viewer.outcomes[seq].effective_frame or 0) <= shown + 0.7 * 20


def test_an_edit_beyond_a_cut_window_holds_where_its_outcome_says_even_if_the_window_is_discarded() -> None:
    stage, viewer = _playing()
    stage.run_until(lambda: viewer.buffered_to - viewer.shown > 35)
    shown = viewer.shown
    stage.set_prompts(viewer, prompt(2), prompt(3, 3, shown + 16))
    slow = iter([0.01, 0.01, 0.01, 0.5])
    stage.runner.step_s = lambda rows: next(slow, 0.01)
    stage.run(0.03)
    seq = stage.set_prompts(viewer, prompt(4, 4, shown + 24))
    stage.run(3.0)
    assert stage.total("windows_discarded") == 1
    effective = viewer.outcomes[seq].effective_frame
    assert effective is not None
    assert _markers(viewer, effective, viewer.buffered_to) == {4}


def test_a_client_that_starts_to_play_during_the_last_step_is_not_overrun() -> None:
    stage, viewer = _playing()
    stage.pause(viewer, True)
    stage.run(2.0)
    steps = itertools.count(1)

    def step_s(rows: int) -> float:
        if next(steps) != 4:
            return 0.01
        stage.pause(viewer, False)
        return 1.0

    stage.runner.step_s = step_s
    stage.set_prompts(viewer, prompt(2))
    stage.run(3.0)
    assert stage.total("windows_discarded") == 1
    assert viewer.rows[-1][PROMPT] == 2


def test_a_plan_number_is_used_again_when_its_window_was_withdrawn() -> None:
    stage, viewer = _playing()
    _start_job(stage, steps=1)
    stage.set_prompts(viewer, prompt(2))
    stage.run(0.3)
    assert [job.plan for job in stage.runner.prepared] == [1, 2, 2]
    assert {int(row[PLAN]) for row in viewer.rows} == {1, 2}


def test_a_server_too_slow_for_real_time_still_makes_motion_and_counts_the_misses() -> None:
    stage = Stage()
    viewer = stage.open()
    stage.runner.step_s = lambda rows: 0.75
    stage.run(30.0)
    assert viewer.underruns > 3
    assert viewer.buffered_to > 200
    assert stage.total("deadline_misses") > 3
    assert stage.total("client_underruns") > 3
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(30.0)
    assert viewer.outcomes[seq].code is Code.OK
    stage.close(viewer)
    stage.run(0.1)
    assert viewer.closed is not None
    assert viewer.closed.late_frames > 0
    stage.check_finished()


# ---- pause and odd playheads -----------------------------------------------------------------------------------------


def test_a_paused_session_costs_nothing_and_can_be_edited() -> None:
    stage, viewer = _playing()
    seq = stage.pause(viewer, True)
    stage.run(5.0)
    windows = len(stage.runner.prepared)
    shown = viewer.shown
    stage.run(30.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert (len(stage.runner.prepared), viewer.shown) == (windows, shown)
    edit = stage.set_prompts(viewer, prompt(2))
    stage.run(0.5)
    assert shown < (viewer.outcomes[edit].effective_frame or 0) <= shown + 10
    stage.pause(viewer, False)
    stage.run(10.0)
    assert viewer.underruns == 0
    assert viewer.shown == pytest.approx(shown + 200, abs=3)
    stage.check_finished()


@pytest.mark.parametrize("frame", [0, 5, 10**6, 2**63])
def test_a_wrong_playhead_breaks_no_rule(frame: int) -> None:
    stage, viewer = _playing()
    stage.engine.submit(viewer.lie(frame, stage.clock.now()))
    stage.run(3.0)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(10.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert viewer.rows[-1][PROMPT] == 2
    stage.check_finished()


def test_a_playhead_before_any_frame_is_harmless() -> None:
    stage = Stage()
    viewer = stage.open()
    stage.engine.submit(viewer.lie(0, stage.clock.now()))
    stage.runner.step_s = lambda rows: 0.5
    stage.run(4.0)
    assert viewer.buffered_to == 40


# ---- measures --------------------------------------------------------------------------------------------------------


def test_latencies_are_measured_from_the_event_to_its_first_frame() -> None:
    stage = Stage()
    stage.runner.step_s = lambda rows: 0.02
    viewer = stage.open()
    stage.run(1.0)
    stage.set_prompts(viewer, prompt(2))
    stage.run(1.0)
    latencies = [latency for report in stage.reports for latency in report.event_latencies]
    assert [latency.kind for latency in latencies] == ["open", "prompts"]
    assert all(latency.seconds == pytest.approx(0.08, abs=0.01) for latency in latencies)


def test_what_was_sent_and_superseded_adds_up() -> None:
    stage, viewer = _playing()
    stage.set_prompts(viewer, prompt(2))
    stage.run(1.0)
    stage.close(viewer)
    stage.run(0.1)
    assert viewer.closed is not None
    assert viewer.closed.num_frames == viewer.buffered_to
    assert stage.total("frames_sent") == sum(len(chunk.rows) for chunk in viewer.chunks)
    assert stage.total("frames_sent") - stage.total("frames_superseded") == viewer.buffered_to
