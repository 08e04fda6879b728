"""A playhead that jumps ahead, and one that may go no further."""

import math

from motiongen_server.engine.session import planning
from tests.server.engine.session.playing import playing_state
from tests.server.engine.stage import prompt


def test_a_playhead_beyond_the_plan_makes_the_motion_go_on_from_its_end_without_a_gap() -> None:
    stage, viewer, _ = playing_state()
    end = viewer.buffered_to
    stage.engine.submit(viewer.lie(end + 500, stage.clock.now()))
    stage.run(0.1)
    assert len(viewer.rows) > end
    assert viewer.chunks[-1].first_frame <= end + 40
    (due,) = [job for job in stage.runner.prepared if job.first_frame == end]
    assert due.deadline > stage.clock.now(), "nobody is late because a client jumps"


def test_a_playhead_that_jumps_over_the_start_of_a_running_replan_has_it_made_again() -> None:
    stage, viewer, _ = playing_state()
    stage.run_until(lambda: viewer.buffered_to - viewer.shown > 30)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.step()
    (job,) = stage.runner.jobs.values()
    stage.engine.submit(viewer.lie(job.first_frame + 3, stage.clock.now()))
    stage.run(1.0)
    assert stage.total("windows_discarded") == 1
    assert (viewer.outcomes[seq].effective_frame or 0) > job.first_frame + 3


def test_a_session_whose_credit_is_used_up_does_not_ask_to_be_looked_at() -> None:
    stage, viewer, state = playing_state(lookahead=20)
    stage.silent.add(viewer.key)
    stage.run(20.0)
    assert state.running is None
    assert not planning.window_due(state, stage.clock.now())
    assert planning.wake_at(state) == math.inf
