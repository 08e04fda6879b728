"""An edit at any moment of a window takes effect at the frame that its outcome names, and not before."""

import pytest

from motiongen_server.engine.types import Code, Waypoint
from tests.server.engine.fakes import CONSTRAINTS, PROMPT
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer


def _window_begun(num_steps: int = 4) -> tuple[Stage, Viewer]:
    """A stage at the moment when a continuing window has been scheduled and has done no step."""
    stage = Stage()
    viewer = stage.open(prompts=(prompt(1),), num_steps=num_steps)
    stage.run(0.5)
    windows = len(stage.runner.prepared)
    stage.run_until(lambda: stage.engine.sessions[viewer.key].running is not None or _more(stage, windows))
    return stage, viewer


def _more(stage: Stage, windows: int) -> bool:
    return len(stage.runner.prepared) > windows


def _check(stage: Stage, viewer: Viewer, seqs: list[int], column: int, value: int) -> None:
    stage.run(3.0)
    outcomes = [viewer.outcomes[seq] for seq in seqs]
    assert {outcome.code for outcome in outcomes} == {Code.OK}
    effective = outcomes[-1].effective_frame
    assert effective is not None
    assert {int(row[column]) for row in viewer.rows[effective : effective + 20]} == {value}
    assert viewer.underruns == 0
    stage.check_finished()


@pytest.mark.parametrize("steps", range(9))
def test_edit_between_any_two_steps_takes_effect_at_its_outcomes_frame(steps: int) -> None:
    stage, viewer = _window_begun()
    for _ in range(steps):
        stage.step()
    seq = stage.set_prompts(viewer, prompt(2))
    _check(stage, viewer, [seq], PROMPT, 2)
    effective = viewer.outcomes[seq].effective_frame
    assert {int(row[PROMPT]) for row in viewer.rows[:effective]} == {1}


@pytest.mark.parametrize("during", range(1, 9))
def test_edit_during_a_step_takes_effect_at_its_outcomes_frame(during: int) -> None:
    stage, viewer = _window_begun()
    seqs: list[int] = []
    steps = iter(range(1, 1000))

    def step_s(rows: int) -> float:
        if next(steps) == during:
            seqs.append(stage.set_prompts(viewer, prompt(2)))
        return 0.01

    stage.runner.step_s = step_s
    stage.run(2.0)
    _check(stage, viewer, seqs, PROMPT, 2)


def test_two_edits_before_one_step_get_one_plan() -> None:
    stage, viewer = _window_begun()
    for _ in range(6):
        stage.step()
    plans = len(viewer.notices)
    seqs = [stage.set_prompts(viewer, prompt(2)), stage.set_constraints(viewer, Waypoint(1, 75, 1.0, 2.0))]
    stage.run(0.1)
    assert len(viewer.notices) == plans + 1
    assert viewer.notices[-1].event_seqs == tuple(seqs)
    _check(stage, viewer, seqs, CONSTRAINTS, 1)


def test_closing_during_a_window_answers_its_edit_as_cancelled() -> None:
    stage, viewer = _window_begun()
    seq = stage.set_prompts(viewer, prompt(2))
    stage.step()
    stage.close(viewer)
    stage.run(0.1)
    assert viewer.closed is not None
    assert (viewer.outcomes[seq].code, viewer.outcomes[seq].reason) == (Code.CANCELLED, "SESSION_CLOSED")
    assert not stage.runner.jobs


@pytest.mark.parametrize("frame", [0, 5, 2**63 - 1, 2**63, 2**64 - 1])
def test_playhead_that_goes_back_or_is_absurd_harms_nothing(frame: int) -> None:
    stage, viewer = _window_begun()
    reported = stage.engine.sessions[viewer.key].clock.reported
    stage.engine.submit(viewer.lie(frame, stage.clock.now()))
    stage.run(5.0)
    assert stage.engine.sessions[viewer.key].clock.reported >= reported
    assert viewer.shown > 100
    stage.check_finished()
