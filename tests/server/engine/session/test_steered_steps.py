"""Denoising steps while a stick steers: windows in quick succession may take only a share of them."""

from dataclasses import replace

import numpy as np
import pytest

from motiongen_server.engine.types import Direction, Gait, PlanCause, WindowJob
from tests.server.engine.fakes import FACTS
from tests.server.engine.session.playing import waypoint
from tests.server.engine.stage import Stage, prompt

ASKED = 6
WALK = Gait("walk", "a person walks", 0.0, Direction.FORWARD, np.ones(FACTS.embedding_dim, np.float32))


def steered(share: float = 0.5, every_s: float = 0.1, keep_prompt: bool = False, **fields: object) -> list[WindowJob]:
    """The windows that answer a stick which turns all the time."""
    stage = Stage(facts=replace(FACTS, steered_share=share))
    viewer = stage.open(prompts=(prompt(1),), gaits=(WALK,), num_steps=ASKED, **fields)
    stage.run(1.0)
    for number in range(30):
        stage.set_velocity(viewer, 1.0, 0.05 * number, hold_frames=10, keep_prompt=keep_prompt)
        stage.run(every_s)
    stage.run(1.0)
    stage.check_finished()
    return [job for job in stage.runner.prepared if job.cause is PlanCause.EDIT]


@pytest.mark.parametrize(("share", "num_steps"), [(1.0, 6), (0.5, 3), (0.4, 3), (0.05, 2)])
def test_windows_in_quick_succession_take_the_models_share_of_the_steps(share: float, num_steps: int) -> None:
    first, *later = steered(share)
    assert first.num_steps == ASKED, "the first is shown until another event comes"
    assert len(later) > 10
    assert {job.num_steps for job in later} == {num_steps}


def test_windows_that_are_shown_for_longer_take_all_steps() -> None:
    jobs = steered(every_s=1.0)
    assert len(jobs) >= 30
    assert {job.num_steps for job in jobs} == {ASKED}


def test_windows_with_the_sessions_own_prompt_take_all_steps() -> None:
    assert {job.num_steps for job in steered(keep_prompt=True)} == {ASKED}


def test_windows_of_a_session_with_constraints_take_all_steps() -> None:
    assert {job.num_steps for job in steered(constraints=(waypoint(10_000),))} == {ASKED}


def test_model_without_a_steered_share_takes_all_steps() -> None:
    assert FACTS.steered_share == 1.0
    assert {job.num_steps for job in steered(FACTS.steered_share)} == {ASKED}
