"""A rollout depends on its request alone, and an invalid request is refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import BUILT_IN_MODEL, model_folder
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from motiongen_ardy.model.window import WindowError
from motiongen_ardy.text import load_text_encoder

WALK = torch.from_numpy(load_text_encoder("static").encode(["a person walks forward"])[0])


@pytest.fixture(scope="module")
def mini() -> Model:
    """The built-in model, which plans, projects and corrects its motion."""
    return load_checkpoint(model_folder(BUILT_IN_MODEL))


def aimed(model: Model, order: int = 1) -> RolloutRequest:
    """Two windows and a half with goals of the root and of limbs, added in one order (1) or the other (-1)."""
    targets = Targets(model.skeleton)
    hand, foot = model.skeleton.left_hand[0], model.skeleton.right_foot[0]
    tell: list[Any] = [
        lambda: targets.add_waypoints([30, 70], np.array([[0.3, 1.0], [0.4, 3.0]]), np.array([0.2, 4.0])),
        lambda: targets.add_joints(50, [0, hand, foot], np.array([[0.3, 0.9, 2.0], [0.6, 1.2, 2.2], [0.2, 0.1, 2.0]])),
        lambda: targets.add_heading([90], np.array([-0.5])),
    ]
    for one in tell[::order]:
        one()
    return RolloutRequest(100, WALK, seed=3, num_steps=2, targets=targets)


@pytest.fixture(scope="module")
def expected(mini: Model) -> Tensor:
    return rollout(mini, aimed(mini))


@contextmanager
def default_dtype(dtype: torch.dtype) -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@pytest.mark.parametrize(
    "around",
    [
        lambda: default_dtype(torch.float64),
        lambda: default_dtype(torch.bfloat16),
        lambda: torch.device("meta"),
        torch.inference_mode,
        torch.enable_grad,
        lambda: torch.autocast("cpu", torch.bfloat16),
    ],
    ids=["float64", "bfloat16", "another device", "inference mode", "autograd", "autocast"],
)
def test_settings_of_torch_do_not_change_a_rollout(mini: Model, expected: Tensor, around: Any) -> None:
    with around():
        made = rollout(mini, aimed(mini))
    assert made.dtype == torch.float32
    assert torch.equal(made, expected)


def test_text_in_double_precision_is_accepted(mini: Model, expected: Tensor) -> None:
    assert torch.equal(rollout(mini, replace(aimed(mini), text=WALK.double())), expected)


def test_goals_of_different_frames_may_be_added_in_any_order(mini: Model, expected: Tensor) -> None:
    assert torch.equal(rollout(mini, aimed(mini, -1)), expected)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"num_frames": -1}, "num_frames is -1; give 0 or more"),
        ({"start": (0.0, float("nan"), 0.0)}, "start is .*must be finite"),
        ({"start": (0.0, 0.0, float("inf"))}, "start is .*must be finite"),
        ({"text": WALK[:255]}, r"shape \(255,\); this model takes \(256,\) or \(n, 256\)"),
        ({"text": WALK[None, None]}, r"shape \(1, 1, 256\)"),
        ({"text": WALK * float("nan")}, "a text holds NaN"),
        ({"later_text": ((20, WALK / 0),)}, "a text holds NaN or infinite"),
    ],
)
def test_an_invalid_request_is_refused(mini: Model, given: dict[str, Any], message: str) -> None:
    with pytest.raises(WindowError, match=message):
        rollout(mini, replace(RolloutRequest(40, WALK, num_steps=2), **given))


@pytest.mark.parametrize("seed", [1.5, -1, 2**64])
def test_a_seed_that_is_not_a_64_bit_integer_is_refused(mini: Model, seed: Any) -> None:
    with pytest.raises(ValueError, match="must be a whole number from 0"):
        rollout(mini, RolloutRequest(4, WALK, seed=seed, num_steps=1))
