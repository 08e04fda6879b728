"""Levels of service: fewer steps, no guidance, held poses."""

import math

import numpy as np
import pytest

from motiongen_server.engine.scheduling.levels import FULL, Level
from motiongen_server.engine.scheduling.load_monitor import LoadMonitor
from motiongen_server.engine.session import planning
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import Code, Guidance, PlanCause, Priority, ServiceLevel, ServiceTier, Waypoint
from tests.server.engine.fakes import SPEED
from tests.server.engine.session.playing import playing_state
from tests.server.engine.stage import Stage, prompt

HOLD = Level(ServiceTier.HOLD, hold=True)


def test_level_is_reported_once_and_applies_from_the_next_window() -> None:
    stage, viewer, state = playing_state(num_steps=8)
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
def test_level_gives_no_more_steps_than_asked_for_nor_fewer_than_the_minimum(
    asked: int, level: int | None, given: int
) -> None:
    _, _, state = playing_state(num_steps=asked)
    state.set_tier(Level(ServiceTier.FEWER_STEPS, steps=level))
    assert state.num_steps == given


def test_dropped_guidance_leaves_weights_that_need_fewer_evaluations() -> None:
    stage, viewer, state = playing_state()
    state.set_tier(Level(ServiceTier.NO_GUIDANCE, drop_guidance=True))
    stage.set_prompts(viewer, prompt(2))
    stage.run(0.1)
    assert stage.runner.prepared[-1].guidance == Guidance(1.0, 0.0)
    stage.set_constraints(viewer, Waypoint(1, viewer.buffered_to + 5, 0.0, 0.0))
    stage.run(0.3)
    # The fake model guides text and constraints together.
    assert stage.runner.prepared[-1].guidance == Guidance(1.0, 0.0)


def test_full_stride_level_restarts_no_window() -> None:
    stage, viewer, state = playing_state(num_steps=10)
    state.set_tier(Level(ServiceTier.FULL, full_stride=True))
    for n in range(40):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.05)
    assert stage.total("windows_restarted") == 0
    stage.run(1.0)
    stage.check_finished()


def _hold(stage: Stage, state: SessionState, seconds: float) -> None:
    stage.runner.holds = True
    state.set_tier(HOLD)
    stage.engine.sessions.touch(state)
    stage.run(seconds)


def test_holding_session_repeats_its_last_pose_without_underruns() -> None:
    stage, viewer, state = playing_state()
    windows = len(stage.runner.prepared)
    _hold(stage, state, 20.0)
    assert len(stage.runner.prepared) <= windows + 1
    assert viewer.underruns == 0
    assert viewer.shown > 350
    held = viewer.rows[state.timeline.motion_from + 60 :]
    assert all(np.array_equal(row, viewer.rows[-1]) for row in held[-200:])
    assert [notice.cause for notice in viewer.notices].count(PlanCause.FALLBACK) == 1
    assert stage.total("frames_held") >= 300


def test_motion_after_a_hold_continues_from_the_held_pose() -> None:
    stage, viewer, state = playing_state()
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


def test_edit_during_a_hold_is_answered_after_the_hold() -> None:
    stage, viewer, state = playing_state()
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
    stage, viewer, state = playing_state()
    _hold(stage, state, 5.0)
    seq = stage.set_prompts(viewer, prompt(2))
    before = state.planned_to
    stage.run_until(lambda: state.planned_to > before)
    end = state.planned_to
    state.set_tier(FULL)
    stage.engine.sessions.touch(state)
    stage.run(1.0)
    assert viewer.outcomes[seq].effective_frame == end


def test_session_on_hold_from_its_opening_still_gets_its_first_window() -> None:
    stage = Stage()
    viewer = stage.open()
    stage.engine.step()
    stage.engine.sessions[viewer.key].set_tier(HOLD)
    stage.run(1.0)
    assert viewer.buffered_to >= 40


@pytest.mark.parametrize("options", [{"lookahead": 40}, {"denoise_steps": 2}, {"priority": Priority.NEAR}])
def test_options_do_not_end_a_hold(options: dict[str, object]) -> None:
    stage, viewer, state = playing_state()
    _hold(stage, state, 5.0)
    windows = len(stage.runner.prepared)
    seq = stage.set_options(viewer, **options)
    stage.run(5.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert state.level is HOLD
    assert len(stage.runner.prepared) == windows
    assert viewer.levels == [], "its level has not changed"


@pytest.mark.parametrize("holds_there", [True, False])
def test_session_moved_to_another_class_gets_the_level_of_that_class(
    holds_there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage, viewer, state = playing_state()
    _hold(stage, state, 5.0)
    fewer = Level(ServiceTier.FEWER_STEPS, steps=3)
    part = Level(ServiceTier.HOLD, hold=True, held_share=0.5, others=fewer)
    monkeypatch.setattr(LoadMonitor, "level", lambda self, priority: part if holds_there else fewer)
    stage.set_options(viewer, priority=Priority.CROWD)
    stage.run(0.1)
    assert state.level is (part if holds_there else fewer)
    stage.set_options(viewer, priority=Priority.BATCH)
    stage.run(0.1)
    assert state.level is (part if holds_there else fewer)


def test_no_pose_is_held_without_end_for_a_paused_or_silent_client() -> None:
    stage, viewer, state = playing_state()
    stage.pause(viewer, True)
    _hold(stage, state, 10.0)
    assert stage.total("frames_held") == 0
    stage.pause(viewer, False)
    stage.silent.add(viewer.key)
    stage.run(60.0)
    assert viewer.buffered_to <= viewer.reported + viewer.lookahead
    assert state.planned_to <= viewer.reported + viewer.lookahead + 60
    assert not math.isnan(planning.wake_at(state))
