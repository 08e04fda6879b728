"""Options that change while a session is open: they apply from the next window on, if there is capacity for them."""

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Code, Guidance, PlayState, Priority
from tests.server.engine.session.playing import playing, playing_state
from tests.server.engine.stage import Stage, prompt


def test_steps_guidance_and_history_apply_from_the_next_window_on() -> None:
    stage, viewer = playing()
    before = len(stage.runner.prepared)
    seq = stage.set_options(viewer, denoise_steps=7, guidance=Guidance(1.0, 3.0), history_frames=8)
    stage.run(3.0)
    assert (viewer.outcomes[seq].code, viewer.outcomes[seq].effective_frame) == (Code.OK, None)
    later = stage.runner.prepared[before:]
    assert later
    assert {(job.num_steps, job.guidance.text, len(job.history)) for job in later} == {(7, 1.0, 8)}
    assert {job.num_steps for job in stage.runner.prepared[:before]} == {4}
    stage.check_finished()


@pytest.mark.parametrize("lookahead", [70, 40])
def test_changed_look_ahead_is_respected(lookahead: int) -> None:
    stage = Stage()
    viewer = stage.open(lookahead=60)
    stage.run(2.0)
    viewer.lookahead = max(lookahead, 60)
    stage.set_options(viewer, lookahead=lookahead)
    stage.run(7.0)
    assert lookahead - 25 <= viewer.buffered_to - viewer.shown <= lookahead + 1
    stage.check_finished()


def test_session_counts_in_its_new_class_after_a_change() -> None:
    stage = Stage()
    viewer = stage.open(priority=Priority.CROWD)
    other = stage.open(2)
    stage.run(0.5)
    seq = stage.set_options(viewer, priority=Priority.HERO)
    stage.run(0.5)
    assert viewer.outcomes[seq].code is Code.OK
    sessions = next(report.sessions for report in reversed(stage.reports) if report.sessions is not None)
    assert sessions == {(Priority.HERO, PlayState.PLAYING): 1, (Priority.NEAR, PlayState.PLAYING): 1}
    stage.close(viewer)
    stage.close(other)
    stage.run(0.2)
    sessions = next(report.sessions for report in reversed(stage.reports) if report.sessions is not None)
    assert not sessions
    assert stage.engine.admission.asked == 0.0


def test_options_beyond_the_capacity_are_refused_and_change_nothing() -> None:
    stage = Stage(EngineConfig(admit_load=(0.3, 0.3, 0.3, 0.3)))
    viewers = [stage.open(handle, num_steps=2) for handle in range(1, 3)]
    stage.run(2.0)
    stage.runner.step_s = lambda rows: 0.2  # the machine has become slow
    stage.run(8.0)
    before = len(stage.runner.prepared)
    seq = stage.set_options(viewers[0], denoise_steps=10)
    stage.run(3.0)
    outcome = viewers[0].outcomes[seq]
    assert (outcome.reason, outcome.field) == ("OVERLOADED", "set_options")
    assert outcome.retry_after_s is not None
    assert {job.num_steps for job in stage.runner.prepared[before:]} <= {2}


@pytest.mark.parametrize("rewind_s", [0.0, 2.0])
def test_longer_history_starts_with_the_frames_kept_and_grows(rewind_s: float) -> None:
    stage, viewer = playing(EngineConfig(rewind_s=rewind_s), history_frames=4)
    stage.run(15.0)
    stage.set_options(viewer, history_frames=160)
    before = len(stage.runner.prepared)
    for marker in range(2, 5):
        stage.set_prompts(viewer, prompt(marker))
        stage.run(1.0)
    stage.run(20.0)
    later = stage.runner.prepared[before:]
    for job in later:
        assert [row[0] for row in job.history] == list(range(job.first_frame - len(job.history), job.first_frame))
    assert 0 < len(later[0].history) < 160 == len(later[-1].history)
    assert stage.runner.breaches == []


def test_class_can_change_while_a_window_waits_to_begin() -> None:
    """The waiting window goes to the new class with its session, and neither leaves anything in the old one."""
    stage = Stage()
    stage.runner.step_s = lambda rows: 0.03
    viewer, other, third = (stage.open(number, priority=Priority.CROWD, prompts=(prompt(1),)) for number in (1, 2, 3))
    stage.run(3.0)
    stage.set_prompts(other, prompt(5))
    stage.run_until(lambda: bool(stage.runner.jobs))
    seq = stage.set_prompts(viewer, prompt(2))  # it waits for the other session's window to be done
    stage.step()
    assert stage.engine.sessions[viewer.key].running is not None
    stage.set_options(viewer, priority=Priority.HERO)
    stage.run(3.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert not any(each.closed for each in (viewer, other, third))
    stage.check_finished()


def test_continue_threshold_follows_the_look_ahead_and_returns_with_it() -> None:
    stage, viewer, state = playing_state()
    viewer.lookahead = 120
    before, found = state.continue_threshold, []
    for lookahead in (120, 90, 40):
        stage.set_options(viewer, lookahead=lookahead)
        stage.run(0.1)
        found.append(state.continue_threshold - before)
    horizon, least = state.facts.horizon, state.config.continue_threshold
    assert found == [max(least, lookahead - horizon) - max(least, 40 - horizon) for lookahead in (120, 90, 40)]
    assert found[0] > found[1] > found[2] == 0
