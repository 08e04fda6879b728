"""Playheads that jump ahead, and sessions whose credit is used up."""

import math

from motiongen_server.engine.session import planning
from tests.server.engine.session.playing import playing_state
from tests.server.engine.stage import prompt


def test_playhead_beyond_the_plan_continues_the_motion_from_the_plans_end() -> None:
    stage, viewer, _ = playing_state()
    end = viewer.buffered_to
    stage.engine.submit(viewer.lie(end + 500, stage.clock.now()))
    stage.run(0.1)
    assert len(viewer.rows) > end
    assert viewer.chunks[-1].first_frame <= end + 40
    (due,) = [job for job in stage.runner.prepared if job.first_frame == end]
    assert due.deadline > stage.clock.now(), "the window is not late because a client jumps"


def test_replan_is_made_again_if_the_playhead_jumps_over_its_start() -> None:
    stage, viewer, _ = playing_state()
    stage.run_until(lambda: viewer.buffered_to - viewer.shown > 30)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.step()
    (job,) = stage.runner.jobs.values()
    stage.engine.submit(viewer.lie(job.first_frame + 3, stage.clock.now()))
    stage.run(1.0)
    assert stage.total("windows_discarded") == 1
    assert (viewer.outcomes[seq].effective_frame or 0) > job.first_frame + 3


def test_session_without_credit_asks_for_no_window_and_no_wake_up() -> None:
    stage, viewer, state = playing_state(lookahead=20)
    stage.silent.add(viewer.key)
    stage.run(20.0)
    assert state.running is None
    assert not planning.window_due(state, stage.clock.now())
    assert planning.wake_at(state) == math.inf
