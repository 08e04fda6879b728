"""How many denoising steps windows have that only follow a stick, which speaks again before they are played."""

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.windows import steered_steps
from motiongen_server.engine.types import Code, PlanCause, Priority, WindowJob
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer


def _playing(config: EngineConfig | None = None, num_steps: int = 8) -> tuple[Stage, Viewer]:
    stage = Stage(config or EngineConfig(steered_steps=0.5), report_every_s=0.25)
    viewer = stage.open(prompts=(prompt(1),), priority=Priority.HERO, num_steps=num_steps)
    stage.run(1.0)
    return stage, viewer


def _steer(stage: Stage, viewer: Viewer, times: int, every_s: float = 0.1) -> list[WindowJob]:
    """The windows that were made for the words of a stick."""
    before = len(stage.runner.prepared)
    for number in range(times):
        stage.set_velocity(viewer, 1.0, 0.1 * (number % 7), hold_frames=10)
        stage.run(every_s)
    return [job for job in stage.runner.prepared[before:] if job.cause is PlanCause.EDIT]


@pytest.mark.parametrize(("asked", "given"), [(8, 4), (10, 5), (4, 2), (3, 2), (2, 2)])
def test_from_its_second_word_on_a_stick_is_followed_with_half_of_the_steps(asked: int, given: int) -> None:
    stage, viewer = _playing(num_steps=asked)
    steps = [job.num_steps for job in _steer(stage, viewer, 20)]
    assert steps[0] == asked
    assert set(steps[1:]) == {given}
    stage.check_finished()


def test_whoever_speaks_now_and_then_gets_all_steps() -> None:
    stage, viewer = _playing()
    assert {job.num_steps for job in _steer(stage, viewer, 8, every_s=0.5)} == {8}


def test_many_words_at_one_moment_are_no_stick() -> None:
    stage, viewer = _playing()
    before = len(stage.runner.prepared)
    for number in range(5):
        stage.set_velocity(viewer, 1.0, 0.1 * number)
    stage.run(0.5)
    assert [job.num_steps for job in stage.runner.prepared[before:]] == [8]


def test_a_window_that_came_too_late_is_made_again_with_as_many_steps() -> None:
    stage, viewer = _playing()
    stage.run_until(lambda: viewer.buffered_to - viewer.shown > 30)
    slow = iter([0.2] * 8)
    stage.runner.step_s = lambda rows: next(slow, 0.01)
    before = len(stage.runner.prepared)
    stage.set_velocity(viewer, 1.0, 0.0, hold_frames=50)
    stage.run(4.0)
    assert stage.total("windows_discarded") == 1
    made = [job.num_steps for job in stage.runner.prepared[before:] if job.cause is PlanCause.EDIT]
    assert made == [8, 8]


def test_when_the_stick_rests_its_character_goes_on_with_all_steps() -> None:
    stage, viewer = _playing()
    _steer(stage, viewer, 5)
    stage.run(0.5)
    before = len(stage.runner.prepared)
    stage.run(4.0)
    rest = stage.runner.prepared[before:]
    assert rest
    assert {job.num_steps for job in rest} == {8}


def test_a_prompt_beside_the_stick_gets_all_steps() -> None:
    stage, viewer = _playing()
    _steer(stage, viewer, 5)
    before = len(stage.runner.prepared)
    stage.set_velocity(viewer, 0.0, 1.0, hold_frames=10)
    asked = stage.set_prompts(viewer, prompt(2))
    stage.run(0.1)
    assert [job.num_steps for job in stage.runner.prepared[before:]] == [8]
    assert viewer.outcomes[asked].code is Code.OK


def test_a_stick_can_be_followed_with_all_steps() -> None:
    stage, viewer = _playing(EngineConfig(steered_steps=1.0))
    assert {job.num_steps for job in _steer(stage, viewer, 20)} == {8}


def test_a_stick_misses_no_frame_and_has_every_word_answered() -> None:
    stage, viewer = _playing()
    _steer(stage, viewer, 60)
    stage.run(1.0)
    assert viewer.underruns == 0
    assert all(outcome.code is Code.OK for outcome in viewer.outcomes.values())
    stage.check_finished()


@pytest.mark.parametrize("share", [0.0, -0.5, 1.1])
def test_the_share_of_steps_is_one(share: float) -> None:
    with pytest.raises(ValueError, match="steered_steps"):
        EngineConfig(steered_steps=share)


def test_there_are_never_more_steps_than_asked_for_nor_fewer_than_the_model_takes() -> None:
    found = [steered_steps(num_steps, 0.5, FACTS) for num_steps in range(FACTS.min_steps, FACTS.max_steps + 1)]
    assert found == sorted(found)
    assert all(FACTS.min_steps <= each <= FACTS.min_steps + index for index, each in enumerate(found))
