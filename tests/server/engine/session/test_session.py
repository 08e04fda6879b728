"""A session from its opening on, seen by a viewer that checks what must always hold."""

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Code, PlanCause, StartPose
from tests.server.engine.fakes import PROMPT
from tests.server.engine.session.playing import markers, playing, waypoint
from tests.server.engine.stage import Stage, prompt

# ---- opening, continuing, credit -------------------------------------------------------------------------------------


def test_open_is_answered_with_the_session_and_then_its_first_plan() -> None:
    stage = Stage()
    viewer = stage.open(seed=77, prompts=(prompt(5),))
    stage.run(0.2)
    assert viewer.opened is not None
    assert (viewer.opened.seed, viewer.opened.start_frame, viewer.opened.committed_horizon) == (77, 0, 5)
    (notice,) = viewer.notices
    assert (notice.plan, notice.valid_from, notice.cause, notice.event_seqs) == (1, 0, PlanCause.CONTINUE, ())
    assert [len(chunk.rows) for chunk in viewer.chunks] == [8, 20, 12]
    assert markers(viewer, 0, 40) == {5}
    (job,) = stage.runner.prepared
    assert (job.seed, job.plan, job.num_steps, job.start_pose) == (77, 1, 4, StartPose())
    assert job.deadline == pytest.approx(100.0 + EngineConfig().open_target_s)
    assert job.runs_out_at == pytest.approx(100.0 + EngineConfig().open_limit_s)


def test_motion_continues_without_a_gap() -> None:
    stage, viewer = playing()
    stage.run(30.0)
    assert viewer.underruns == 0
    assert viewer.shown == pytest.approx(31 * 20, abs=3)
    assert {notice.cause for notice in viewer.notices} == {PlanCause.CONTINUE}
    assert [notice.valid_from for notice in viewer.notices] == [40 * n for n in range(len(viewer.notices))]
    stage.check_finished()


def test_chunks_have_at_most_20_frames() -> None:
    stage = Stage()
    viewer = stage.open(lookahead=80)
    stage.run(20.0)
    assert max(len(chunk.rows) for chunk in viewer.chunks) == 20


def test_without_a_playhead_one_look_ahead_is_sent_and_no_more_computed() -> None:
    stage = Stage()
    viewer = stage.open(lookahead=30)
    stage.silent.add(viewer.key)
    stage.run(60.0)
    assert viewer.buffered_to == 30
    assert len(stage.runner.prepared) == 1


def test_silent_client_stops_the_generation_until_it_reports_again() -> None:
    stage, viewer = playing()
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
    stage, viewer = playing(lookahead=80)
    stage.run(20.0)
    stage.report(viewer)
    stage.run(0.1)
    assert viewer.buffered_to - viewer.shown > 35


def test_old_frames_and_past_conditions_are_dropped() -> None:
    stage, viewer = playing()
    state = stage.engine.sessions[viewer.key]
    for n in range(100):
        frame = viewer.buffered_to + 10
        stage.set_constraints(viewer, waypoint(frame, constraint_id=n))
        stage.set_prompts(viewer, prompt(n, prompt_id=n + 2, start=frame, end=frame + 5))
        stage.run(1.0)
        assert len(state.timeline.rows) <= 160
        assert len(state.conditions.constraints) < 10
        assert len(state.conditions.prompts) < 10
        assert len(state.edits.unseen) < 10


# ---- pause and odd playheads -----------------------------------------------------------------------------------------


def test_paused_session_makes_no_windows_and_can_be_edited() -> None:
    stage, viewer = playing()
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
def test_false_playhead_breaks_no_rule(frame: int) -> None:
    stage, viewer = playing()
    stage.engine.submit(viewer.lie(frame, stage.clock.now()))
    stage.run(3.0)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(10.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert viewer.rows[-1][PROMPT] == 2
    stage.check_finished()


def test_playhead_reported_before_any_frame_is_harmless() -> None:
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


def test_counts_of_frames_sent_and_superseded_add_up() -> None:
    stage, viewer = playing()
    stage.set_prompts(viewer, prompt(2))
    stage.run(1.0)
    stage.close(viewer)
    stage.run(0.1)
    assert viewer.closed is not None
    assert viewer.closed.num_frames == viewer.buffered_to
    assert stage.total("frames_sent") == sum(len(chunk.rows) for chunk in viewer.chunks)
    assert stage.total("frames_sent") - stage.total("frames_superseded") == viewer.buffered_to
