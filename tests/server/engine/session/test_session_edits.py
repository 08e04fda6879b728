"""Edits: what they replace, from when on they take effect, and how they are answered."""

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Code, PlanCause, Priority
from tests.server.engine.fakes import CONSTRAINTS, PROMPT
from tests.server.engine.session.playing import markers, playing, start_job, waypoint
from tests.server.engine.stage import Stage, prompt


def test_prompt_replaces_frames_soon_after_the_playhead_and_none_before() -> None:
    stage, viewer = playing()
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
    assert markers(viewer, 0, outcome.effective_frame) == {1}
    assert markers(viewer, outcome.effective_frame, viewer.buffered_to) == {2}
    assert next(len(chunk.rows) for chunk in viewer.chunks if chunk.plan == notice.plan) == 8


def test_plan_notice_precedes_the_outcome_and_both_precede_the_frames() -> None:
    stage, viewer = playing()
    before = len(stage.outputs)
    stage.set_prompts(viewer, prompt(2))
    stage.run(0.1)
    assert [type(output).__name__ for output in stage.outputs[before:]][:3] == ["PlanNotice", "Outcome", "Chunk"]


def test_several_edits_cause_one_replan_and_each_gets_its_outcome() -> None:
    stage, viewer = playing()
    plans = len(viewer.notices)
    seqs = [
        stage.set_prompts(viewer, prompt(2)),
        stage.set_constraints(viewer, waypoint(60)),
        stage.set_prompts(viewer, prompt(3)),
    ]
    stage.run(0.1)
    assert len(viewer.notices) == plans + 1
    assert viewer.notices[-1].event_seqs == tuple(seqs)
    assert len({viewer.outcomes[seq].effective_frame for seq in seqs}) == 1
    assert viewer.rows[-1][PROMPT] == 3
    assert viewer.rows[-1][CONSTRAINTS] == 1


def test_edits_before_the_first_frame_take_effect_at_frame_0() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1),))
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(0.2)
    assert viewer.outcomes[seq].effective_frame == 0
    assert markers(viewer, 0, 40) == {2}
    assert stage.runner.prepared[0].start_pose is not None


def test_an_edit_early_in_a_running_window_restarts_it() -> None:
    stage, viewer = playing()
    start_job(stage, steps=1)
    (running,) = stage.runner.jobs
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(0.2)
    assert running in stage.runner.discarded
    assert stage.total("windows_restarted") == 1
    assert viewer.notices[-1].event_seqs == (seq,)
    assert markers(viewer, viewer.notices[-1].valid_from, viewer.buffered_to) == {2}


def test_edit_late_in_a_running_window_is_answered_by_the_next_one() -> None:
    stage, viewer = playing()
    start_job(stage, steps=2)
    (running,) = stage.runner.jobs
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(0.2)
    assert running in stage.runner.decoded
    assert stage.total("windows_restarted") == 0
    assert [notice.event_seqs for notice in viewer.notices[-2:]] == [(), (seq,)]


def test_continuous_edits_discard_hardly_any_begun_windows() -> None:
    stage, viewer = playing(num_steps=10)
    seqs = []
    for n in range(40):
        seqs.append(stage.set_prompts(viewer, prompt(n)))
        stage.run(0.01)
    plans = [notice for notice in viewer.notices if notice.cause is PlanCause.EDIT]
    assert len(plans) == 3  # at five a second, as the class may have, and with one saved up in a quiet time
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
    assert markers(viewer, viewer.notices[-1].valid_from, viewer.buffered_to) == {3}


def test_an_edit_that_changes_nothing_makes_no_plan() -> None:
    stage, viewer = playing()
    plans = len(viewer.notices)
    seq = stage.set_prompts(viewer, prompt(1))
    empty = stage.set_constraints(viewer, clear=True)
    stage.run(0.05)
    assert (viewer.outcomes[seq].code, viewer.outcomes[seq].effective_frame) == (Code.OK, None)
    assert (viewer.outcomes[empty].code, viewer.outcomes[empty].effective_frame) == (Code.OK, None)
    assert len(viewer.notices) == plans


def test_a_refused_edit_changes_nothing_and_says_why() -> None:
    stage, viewer = playing()
    plans = len(viewer.notices)
    seq = stage.set_constraints(viewer, waypoint(60, 1), waypoint(3, 2))
    stage.run(0.05)
    outcome = viewer.outcomes[seq]
    assert (outcome.code, outcome.reason) == (Code.FAILED_PRECONDITION, "FRAME_COMMITTED")
    assert (outcome.field, outcome.effective_frame) == ("edit_constraints.upsert[1].frame", None)
    assert len(viewer.notices) == plans
    unknown = stage.set_constraints(viewer, remove=(1,))
    stage.run(0.05)
    assert viewer.outcomes[unknown].reason == "UNKNOWN_CONSTRAINT"


def test_limits_on_prompts_and_constraints_are_enforced() -> None:
    stage, viewer = playing(EngineConfig(max_prompts=2, max_constraints=2))
    prompts = [stage.set_prompts(viewer, prompt(n, prompt_id=n)) for n in (2, 3)]
    constraints = [stage.set_constraints(viewer, waypoint(100, n)) for n in (1, 2, 3)]
    stage.run(0.3)
    assert [viewer.outcomes[seq].reason for seq in prompts] == ["", "TOO_MANY_PROMPTS"]
    assert [viewer.outcomes[seq].reason for seq in constraints] == ["", "", "TOO_MANY_CONSTRAINTS"]


def test_edit_at_the_start_of_a_nearly_finished_window_waits_for_a_later_plan() -> None:
    stage, viewer = playing()
    start_job(stage, steps=3)
    ((first, job),) = [(job.first_frame, job) for job in stage.runner.jobs.values()]
    seq = stage.set_prompts(viewer, prompt(2, 2, first))
    stage.step()
    assert seq not in viewer.outcomes
    stage.run(3.0)
    outcome = viewer.outcomes[seq]
    assert outcome.effective_frame is not None
    assert outcome.effective_frame >= first
    assert any(seq in notice.event_seqs for notice in viewer.notices if notice.plan > job.plan)
    assert markers(viewer, outcome.effective_frame, viewer.buffered_to) == {2}
    stage.check_finished()
