"""What a session gets of the machine: replans a second, the lead its round trip asks for, tokens, levels, holds."""

import math

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.degradation import FULL, Level
from motiongen_server.engine.session import planning
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import Code, Guidance, PlanCause, Priority, ServiceLevel, ServiceTier, Waypoint
from tests.server.engine.fakes import SPEED
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

HOLD = Level(ServiceTier.HOLD, hold=True)


def _playing(config: EngineConfig | None = None, **fields: object) -> tuple[Stage, Viewer, SessionState]:
    stage = Stage(config)
    viewer = stage.open(prompts=(prompt(1),), **fields)
    stage.run(1.0)
    return stage, viewer, stage.engine.sessions[viewer.key]


def _edits(viewer: Viewer) -> int:
    return sum(notice.cause is PlanCause.EDIT for notice in viewer.notices)


# ---- replans a second ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("priority", "replans_hz"), list(zip(Priority, EngineConfig().replans_hz, strict=True)))
def test_a_storm_of_edits_makes_no_more_replans_than_the_class_may_have(priority: Priority, replans_hz: float) -> None:
    stage, viewer, _ = _playing(priority=priority)
    seqs = []
    for n in range(100):
        seqs.append(stage.set_prompts(viewer, prompt(n)))
        stage.run(0.05)
    assert 0.5 * 5 * replans_hz <= _edits(viewer) <= 5 * replans_hz + 2
    stage.run(1.5)
    assert all(viewer.outcomes[seq].code is Code.OK for seq in seqs)
    assert viewer.underruns == 0
    stage.check_finished()


def test_the_first_edit_after_a_quiet_time_does_not_wait() -> None:
    stage, viewer, _ = _playing(priority=Priority.CROWD)
    first = stage.set_prompts(viewer, prompt(2))
    stage.run(0.1)
    assert first in viewer.outcomes
    second = stage.set_prompts(viewer, prompt(3))
    stage.run(0.3)
    assert second not in viewer.outcomes
    stage.run(0.2)
    assert second in viewer.outcomes


def test_a_lower_rung_lets_fewer_replans_through() -> None:
    stage, viewer, state = _playing(priority=Priority.NEAR)
    state.set_tier(Level(ServiceTier.FULL, replan_cap_scale=0.2))
    for n in range(80):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.05)
    assert 3 <= _edits(viewer) <= 6


def test_waiting_for_its_turn_is_no_missed_deadline() -> None:
    stage, viewer, _ = _playing(priority=Priority.CROWD)
    for n in range(60):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.05)
    assert stage.total("deadline_misses") == 0


def test_edits_that_wait_are_bounded_and_the_rest_refused() -> None:
    stage, viewer, state = _playing(EngineConfig(max_waiting_edits=10, max_prompts=200))
    state.set_tier(HOLD)
    seqs = []
    for n in range(20):
        seqs.append(stage.set_prompts(viewer, prompt(n)))
        stage.run(0.01)
    refused = [viewer.outcomes[seq] for seq in seqs if seq in viewer.outcomes]
    assert len(refused) == 10
    assert {(outcome.code, outcome.reason) for outcome in refused} == {
        (Code.RESOURCE_EXHAUSTED, "TOO_MANY_PENDING_EVENTS")
    }
    assert len(state.edits.waiting) == 10


# ---- the round trip --------------------------------------------------------------------------------------------------


def test_a_long_round_trip_moves_the_replan_away_from_the_playhead() -> None:
    effective = {}
    for rtt_s in (0.0, 0.5):
        stage, viewer, _ = _playing()
        viewer.rtt_s = rtt_s
        stage.run_until(lambda stage=stage, viewer=viewer: viewer.buffered_to - viewer.shown > 30)
        shown = viewer.shown
        seq = stage.set_prompts(viewer, prompt(2))
        stage.run(0.2)
        effective[rtt_s] = (viewer.outcomes[seq].effective_frame or 0) - shown
    assert effective[0.5] - effective[0.0] == pytest.approx(0.5 * 20, abs=2)


def test_windows_for_a_client_far_away_are_made_earlier() -> None:
    underruns = {}
    for rtt_s in (None, 0.8):
        stage = Stage(delay_s=0.4)
        viewer = stage.open(prompts=(prompt(1),), lookahead=60)
        viewer.rtt_s = rtt_s
        stage.runner.step_s = lambda rows: 0.1
        stage.run(5.0)
        before = viewer.underruns
        stage.run(30.0)
        underruns[rtt_s] = viewer.underruns - before
    assert underruns[None] > 0
    assert underruns[0.8] == 0


# ---- tokens ----------------------------------------------------------------------------------------------------------


def test_windows_on_the_grid_get_the_tokens_of_their_history_and_others_do_not() -> None:
    stage, viewer, _ = _playing()
    stage.set_prompts(viewer, prompt(2, 2, viewer.shown // 4 * 4 + 17))
    stage.run(6.0)
    starts = [job.first_frame for job in stage.runner.prepared]
    for before, job in zip([0, *starts], stage.runner.prepared, strict=False):
        on_grid = job.first_frame > 0 and (job.first_frame - before) % 4 == 0
        assert (job.history_tokens is not None) == on_grid, job.first_frame
    assert any(job.history_tokens is None for job in stage.runner.prepared[1:])


def test_aligned_replans_stay_on_the_grid() -> None:
    stage, viewer, _ = _playing(EngineConfig(align_replans=True))
    for n in range(20):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.33)
    assert _edits(viewer) > 10
    assert all(job.first_frame % 4 == 0 for job in stage.runner.prepared)
    assert all(job.history_tokens is not None for job in stage.runner.prepared[1:])


def test_an_aligned_replan_still_starts_a_scheduled_prompt_where_it_was_asked_for() -> None:
    stage, viewer, _ = _playing(EngineConfig(align_replans=True))
    start = viewer.shown // 4 * 4 + 17
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(0.2)
    assert start % 4
    assert viewer.outcomes[seq].effective_frame == start


def test_history_can_be_had_encoded_again_every_time() -> None:
    stage, _, _ = _playing(EngineConfig(reuse_tokens=False))
    stage.run(5.0)
    assert len(stage.runner.prepared) > 3
    assert all(job.history_tokens is None for job in stage.runner.prepared)


# ---- levels ---------------------------------------------------------------------------------------------------------


def test_a_rung_is_told_once_and_in_effect_at_the_next_window() -> None:
    stage, viewer, state = _playing(num_steps=8)
    fewer = Level(ServiceTier.FEWER_STEPS, steps=3)
    assert state.set_tier(fewer) == [ServiceLevel(viewer.key, ServiceTier.FEWER_STEPS, 3)]
    assert state.set_tier(fewer) == []
    stage.run(4.0)
    assert state.set_tier(FULL) == [ServiceLevel(viewer.key, ServiceTier.FULL, 8)]
    stage.run(4.0)
    steps = [job.num_steps for job in stage.runner.prepared]
    assert sorted(steps, key=[8, 3].index) != steps
    assert (steps[0], 3 in steps, steps[-1]) == (8, True, 8)


@pytest.mark.parametrize(("asked", "level", "given"), [(8, 3, 3), (2, 3, 2), (8, 1, 2), (8, None, 8)])
def test_a_rung_never_gives_more_steps_than_asked_for_nor_fewer_than_the_model_can_do(
    asked: int, level: int | None, given: int
) -> None:
    _, _, state = _playing(num_steps=asked)
    state.set_tier(Level(ServiceTier.FEWER_STEPS, steps=level))
    assert state.num_steps == given


def test_dropped_guidance_leaves_weights_that_need_fewer_evaluations() -> None:
    stage, viewer, state = _playing()
    state.set_tier(Level(ServiceTier.NO_GUIDANCE, drop_guidance=True))
    stage.set_prompts(viewer, prompt(2))
    stage.run(0.1)
    assert stage.runner.prepared[-1].guidance == Guidance(1.0, 0.0)
    stage.set_constraints(viewer, Waypoint(1, viewer.buffered_to + 5, 0.0, 0.0))
    stage.run(0.3)
    # The fake model guides text and constraints together.
    assert stage.runner.prepared[-1].guidance == Guidance(1.0, 0.0)


def test_a_full_stride_restarts_no_window() -> None:
    stage, viewer, state = _playing(num_steps=10)
    state.set_tier(Level(ServiceTier.FULL, full_stride=True))
    for n in range(40):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.05)
    assert stage.total("windows_restarted") == 0
    stage.run(1.0)
    stage.check_finished()


# ---- held poses ------------------------------------------------------------------------------------------------------


def _hold(stage: Stage, state: SessionState, seconds: float) -> None:
    stage.runner.holds = True
    state.set_tier(HOLD)
    stage.engine.sessions.touch(state)
    stage.run(seconds)


def test_a_session_told_to_hold_repeats_its_last_pose_and_never_runs_out() -> None:
    stage, viewer, state = _playing()
    windows = len(stage.runner.prepared)
    _hold(stage, state, 20.0)
    assert len(stage.runner.prepared) <= windows + 1
    assert viewer.underruns == 0
    assert viewer.shown > 350
    held = viewer.rows[state.timeline.motion_from + 60 :]
    assert all(np.array_equal(row, viewer.rows[-1]) for row in held[-200:])
    assert [notice.cause for notice in viewer.notices].count(PlanCause.FALLBACK) == 1
    assert stage.total("frames_held") >= 300


def test_after_a_hold_motion_goes_on_from_the_pose_that_was_held() -> None:
    stage, viewer, state = _playing()
    _hold(stage, state, 5.0)
    held = viewer.rows[-1].copy()
    end = state.planned_to
    state.set_tier(FULL)
    stage.engine.sessions.touch(state)
    stage.run(3.0)
    job = next(job for job in stage.runner.prepared if job.first_frame >= end)
    assert job.history_tokens is not None
    assert job.history[:, 0].tolist() == list(range(int(job.history[0, 0]), int(job.history[0, 0]) + 16))
    assert held[0] == pytest.approx(job.history[-1, 0] * SPEED / 20)
    assert viewer.underruns == 0
    stage.check_finished()


def test_an_edit_during_a_hold_is_answered_when_it_ends() -> None:
    stage, viewer, state = _playing()
    _hold(stage, state, 5.0)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(2.0)
    assert seq not in viewer.outcomes
    state.set_tier(FULL)
    stage.engine.sessions.touch(state)
    stage.run(2.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert viewer.underruns == 0
    stage.check_finished()


def test_no_window_starts_inside_a_held_pose() -> None:
    stage, viewer, state = _playing()
    _hold(stage, state, 5.0)
    seq = stage.set_prompts(viewer, prompt(2))
    before = state.planned_to
    stage.run_until(lambda: state.planned_to > before)
    end = state.planned_to
    state.set_tier(FULL)
    stage.engine.sessions.touch(state)
    stage.run(1.0)
    assert viewer.outcomes[seq].effective_frame == end


def test_a_session_opened_while_others_hold_gets_its_first_window() -> None:
    stage = Stage()
    viewer = stage.open()
    stage.engine.step()
    stage.engine.sessions[viewer.key].set_tier(HOLD)
    stage.run(1.0)
    assert viewer.buffered_to >= 40


def test_nothing_is_held_for_a_client_that_stands_or_is_silent() -> None:
    stage, viewer, state = _playing()
    stage.pause(viewer, True)
    _hold(stage, state, 10.0)
    assert stage.total("frames_held") == 0
    stage.pause(viewer, False)
    stage.silent.add(viewer.key)
    stage.run(60.0)
    assert viewer.buffered_to <= viewer.reported + viewer.lookahead
    assert state.planned_to <= viewer.reported + viewer.lookahead + 60
    assert not math.isnan(planning.wake_at(state))


# ---- a playhead that jumps -------------------------------------------------------------------------------------------


def test_a_playhead_beyond_the_plan_makes_the_motion_go_on_from_its_end_without_a_gap() -> None:
    stage, viewer, _ = _playing()
    end = viewer.buffered_to
    stage.engine.submit(viewer.lie(end + 500, stage.clock.now()))
    stage.run(0.1)
    assert len(viewer.rows) > end
    assert viewer.chunks[-1].first_frame <= end + 40
    (due,) = [job for job in stage.runner.prepared if job.first_frame == end]
    assert due.deadline > stage.clock.now(), "nobody is late because a client jumps"


def test_a_playhead_that_jumps_over_the_start_of_a_running_replan_has_it_made_again() -> None:
    stage, viewer, _ = _playing()
    stage.run_until(lambda: viewer.buffered_to - viewer.shown > 30)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.step()
    (job,) = stage.runner.jobs.values()
    stage.engine.submit(viewer.lie(job.first_frame + 3, stage.clock.now()))
    stage.run(1.0)
    assert stage.total("windows_discarded") == 1
    assert (viewer.outcomes[seq].effective_frame or 0) > job.first_frame + 3


def test_a_session_whose_credit_is_used_up_does_not_ask_to_be_looked_at() -> None:
    stage, viewer, state = _playing(lookahead=20)
    stage.silent.add(viewer.key)
    stage.run(20.0)
    assert state.running is None
    assert not planning.window_due(state, stage.clock.now())
    assert planning.wake_at(state) == math.inf
