"""A session that starts where the robot is: measured qpos becomes the history of a window."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.generation import WindowRequest, denoise_window, finish_window
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.noise import window_noise
from motiongen_ardy.robot.g1 import RobotError, motion_to_qpos, qpos_to_motion
from motiongen_ardy.robot.seed import history_from_qpos
from tests.ardy.robot.poses import walking_qpos

GOLDEN = Path(__file__).resolve().parents[2] / "data" / "golden"


@pytest.fixture(scope="module")
def g1() -> Model:
    """The golden model of the robot's skeleton."""
    return load_checkpoint(GOLDEN / "tiny-g134" / "checkpoint")


def test_the_history_equals_the_measured_motion(g1: Model) -> None:
    layout = g1.representation
    qpos = walking_qpos(16, layout.fps)
    history = history_from_qpos(layout, qpos, layout.fps)
    assert history.shape == (16, layout.feature_dim)
    again = layout.motion(layout.denormalize(history))
    measured = qpos_to_motion(qpos, layout.fps)
    error = again.positions(layout.skeleton) - measured.positions(layout.skeleton).float()
    assert error.abs().max() < 1e-4
    angles = motion_to_qpos(again)[:, 7:]
    torch.testing.assert_close(angles, qpos[:, 7:], atol=1e-3, rtol=0)


def test_a_history_from_a_faster_robot_ends_at_its_newest_row(g1: Model) -> None:
    layout = g1.representation
    qpos = walking_qpos(203, 500)
    history = history_from_qpos(layout, qpos, 500, max_frames=8)
    assert history.shape[0] == 8
    root = layout.denormalize(history)[:, layout.root_position_block]
    assert root[-1, 2] == pytest.approx(float(qpos[-1, 0]), abs=1e-4)
    assert float(root[-1, 2] - root[0, 2]) == pytest.approx(0.6 * 7 / layout.fps, abs=1e-3)


def test_too_few_rows_are_refused(g1: Model) -> None:
    with pytest.raises(RobotError, match="give 4 or more"):
        history_from_qpos(g1.representation, walking_qpos(3, 25), 25)
    for max_frames in (3, 0, -4):
        with pytest.raises(RobotError, match=f"of which {max_frames} may be used"):
            history_from_qpos(g1.representation, walking_qpos(30, 25), 25, max_frames=max_frames)


@pytest.mark.parametrize(
    ("row", "column", "value", "message"),
    [(151, 9, float("nan"), "row 151 holds NaN"), (7, 3, 1.5, "quaternion in row 7 of qpos has length 1.5")],
)
def test_invalid_state_is_refused_with_the_row_that_was_measured(
    g1: Model, row: int, column: int, value: float, message: str
) -> None:
    qpos = walking_qpos(203, 500)
    qpos[row, column] = value
    with pytest.raises(RobotError, match=message):
        history_from_qpos(g1.representation, qpos, 500)


def test_a_robot_that_reports_either_sign_of_its_quaternion_is_continued_alike(g1: Model) -> None:
    layout = g1.representation
    qpos = walking_qpos(203, 500)
    flipped = qpos.clone()
    flipped[::3, 3:7] *= -1
    history = history_from_qpos(layout, qpos, 500)
    torch.testing.assert_close(history_from_qpos(layout, flipped, 500), history, atol=1e-5, rtol=0)


def test_a_model_of_another_skeleton_is_refused() -> None:
    people = load_checkpoint(GOLDEN / "tiny-core27" / "checkpoint")
    with pytest.raises(RobotError, match="skeleton is core27"):
        history_from_qpos(people.representation, walking_qpos(16, 25), 25)


def test_a_window_is_generated_after_the_measured_history(g1: Model) -> None:
    layout, config = g1.representation, g1.config
    history = history_from_qpos(layout, walking_qpos(8, layout.fps), layout.fps)
    noise = window_noise(1, 0, config.horizon // 4, config.token_width)
    request = WindowRequest(
        num_frames=8 + config.horizon,
        num_steps=2,
        text=torch.zeros(1, 1, config.denoiser.text_dim),
        noise=noise[None],
        history=history[None],
    )
    features = finish_window(g1, denoise_window(g1, request))
    assert features.shape == (1, 8 + config.horizon, layout.feature_dim)
    assert features.isfinite().all()
