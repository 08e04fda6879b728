"""Knees: a shin that was decoded with a twist about its own axis is turned back."""

from __future__ import annotations

import math

import pytest
import torch

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import axis_angle_to_matrix, matrix_to_6d, rotation_vector
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.model.sampling.correct import correct_window
from motiongen_ardy.model.sampling.knees import hinge_knees
from motiongen_ardy.model.sampling.options import SamplingOptions
from tests.ardy.model.sampling.conftest import Stand

SIDES = ("Left", "Right")


def with_twisted_shins(layout: Representation, features: torch.Tensor) -> torch.Tensor:
    """The same poses (1, T, D) with the shins twisted about their own axes, by another angle at every frame."""
    natural, skeleton = layout.denormalize(features).clone(), layout.skeleton
    sixd = natural[..., layout.rotation_block].unflatten(-1, (-1, 6))
    rotations = layout.global_rotations(natural)
    draw = torch.Generator().manual_seed(1)
    for side in SIDES:
        shin = skeleton.index(f"{side}Leg")
        angles = (torch.rand(features.shape[1], generator=draw) - 0.5) * 2 * math.pi
        turn = axis_angle_to_matrix(angles[:, None] * torch.tensor([0.0, 1.0, 0.0]))
        sixd[:, :, shin] = matrix_to_6d(rotations[:, :, shin] @ turn)
    natural[..., layout.rotation_block] = sixd.flatten(-2)
    return layout.normalize(natural)


def test_twisted_shins_are_turned_back(layout: Representation, stand: Stand) -> None:
    features = stand(torch.zeros(10, 3))
    before, turned = (
        layout.global_rotations(layout.denormalize(one)) for one in (features, with_twisted_shins(layout, features))
    )
    after = hinge_knees(layout.skeleton, turned)
    assert rotation_vector(after.transpose(-1, -2) @ before).norm(dim=-1).max() < 2e-3, "the knees were hinges before"


def test_feet_of_a_window_with_twisted_shins_move_smoothly(layout: Representation, stand: Stand) -> None:
    moves = torch.zeros(41, 3)
    moves[:, 1] = -0.1 * (1 - torch.cos(torch.arange(41) * 0.3))
    features = with_twisted_shins(layout, stand(moves))
    new = correct_window(layout, features[:, :1], features[:, 1:], None, SamplingOptions(join_tokens=True))
    positions = layout.positions(layout.denormalize(torch.cat([features[:, :1], new], dim=1)))[0]
    accelerations = positions.diff(dim=0).diff(dim=0).norm(dim=-1) * layout.fps**2
    assert float(accelerations.max()) < 10


@pytest.mark.parametrize("name", ["g134"])
def test_a_robot_with_other_legs_is_left_unchanged(name: str) -> None:
    skeleton = load_skeleton(name)
    rotations = axis_angle_to_matrix(
        torch.randn(1, 4, skeleton.num_joints, 3, generator=torch.Generator().manual_seed(0))
    )
    assert hinge_knees(skeleton, rotations) is rotations
