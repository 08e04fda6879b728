"""Windows that land late, or whose frames were played or committed meanwhile."""

import itertools

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Code, PlanCause, Priority
from tests.server.engine.fakes import PLAN, PROMPT
from tests.server.engine.session.playing import PLAYS_FROM, markers, playing, start_job
from tests.server.engine.stage import Stage, crowd, prompt


def test_window_that_lands_too_late_is_retried_with_a_longer_lead() -> None:
    stage, viewer = playing(EngineConfig(continue_threshold=10))
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
    assert markers(viewer, outcome.effective_frame or 0, viewer.buffered_to) == {2}
    stage.check_finished()


def test_frames_committed_while_a_window_runs_do_not_void_it() -> None:
    stage = Stage(report_every_s=0.02)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run_until(lambda: len(viewer.notices) == 2)
    stage.runner.step_s = lambda rows: 0.03
    seq = stage.set_prompts(viewer, prompt(2))
    promised = viewer.committed_to
    stage.run_until(lambda: seq in viewer.outcomes)
    assert viewer.committed_to > promised
    assert stage.total("windows_discarded") == 0


def test_edit_within_the_first_patch_takes_effect_after_it() -> None:
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1, 1, 0),))
    seq = stage.set_prompts(viewer, prompt(2, 2, 2))
    stage.run(2.0)
    assert viewer.outcomes[seq].effective_frame == 4
    assert (markers(viewer, 0, 4), markers(viewer, 4, 30)) == ({1}, {2})


def test_lead_of_a_replan_follows_the_time_that_windows_take() -> None:
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


def test_edit_beyond_a_cut_window_keeps_its_frame_if_the_window_is_discarded() -> None:
    stage, viewer = playing()
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
    assert markers(viewer, effective, viewer.buffered_to) == {4}


def test_window_is_discarded_if_its_client_plays_past_it_in_the_last_step() -> None:
    stage, viewer = playing()
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


def test_plan_number_of_a_withdrawn_window_is_reused() -> None:
    stage, viewer = playing()
    start_job(stage, steps=1)
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


def test_windows_of_simultaneous_edits_start_where_they_can_be_in_time() -> None:
    stage, viewers = crowd(24, prompts=(prompt(1),))
    stage.runner.step_s = lambda rows: 0.005 + 0.005 * rows
    stage.run(6.0)  # what steps cost is known by now
    asked = {viewer.key: stage.set_prompts(viewer, prompt(2)) for viewer in viewers}
    stage.run(4.0)
    assert stage.total("windows_discarded") == 0
    for viewer in viewers:
        outcome = viewer.outcomes[asked[viewer.key]]
        assert outcome.code is Code.OK
        assert markers(viewer, outcome.effective_frame or 0, viewer.buffered_to) == {2}
    stage.check_finished()


def test_window_starts_sooner_if_it_need_not_wait_for_others_after_all() -> None:
    stage, heroes = crowd(24, prompts=(prompt(1),), priority=Priority.HERO)
    last = stage.open(25, prompts=(prompt(1),), priority=Priority.CROWD)
    stage.runner.step_s = lambda rows: 0.005 + 0.005 * rows
    stage.run(6.0)
    for hero in heroes:
        stage.set_prompts(hero, prompt(2))
    seq = stage.set_prompts(last, prompt(2))
    stage.run(0.03)
    state = stage.engine.sessions.get(last.key)
    assert state is not None
    assert state.running is not None
    meant = state.running.first_frame
    for hero in heroes:
        stage.close(hero)
    stage.run(2.0)
    effective = last.outcomes[seq].effective_frame
    assert effective is not None
    assert effective <= meant - 4
