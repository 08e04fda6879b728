"""Bodies are turned towards the heading of their root."""

from __future__ import annotations

import torch

from motiongen_ardy.core.representation import heading_angle
from motiongen_ardy.core.rotation import rotation_y
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.model.sampling.facing import SWAY_RAD, face_root
from motiongen_ardy.model.sampling.pose import Poses
from motiongen_ardy.train.feature_bank import natural_layout


def standing(num_frames: int) -> Poses:
    """A neutral pose that faces +Z."""
    skeleton = load_skeleton("core27")
    layout = natural_layout(skeleton, 20)
    rotations = torch.eye(3).expand(1, num_frames, skeleton.num_joints, 3, 3).contiguous()
    root = torch.tensor([0.4, 0.9, 0.2]).expand(1, num_frames, 3).contiguous()
    return Poses.of(layout, layout.features(rotations, root))


def shown(poses: Poses) -> torch.Tensor:
    return heading_angle(poses.layout.skeleton, poses.positions())[0]


def test_the_body_follows_a_root_that_turns() -> None:
    poses = standing(41)
    turn = torch.linspace(0, 2.0, 41)
    face_root(poses, torch.stack([turn.cos(), turn.sin()], dim=-1)[None])
    found = shown(poses)
    assert float(found[0]) == 0.0
    assert float((found - turn).abs().max()) < SWAY_RAD + 0.15
    assert float((found - turn)[10:-3].abs().max()) < SWAY_RAD + 0.02
    assert torch.equal(poses.root[0, -1], torch.tensor([0.4, 0.9, 0.2]))


def test_turning_about_up_equals_the_product_with_the_rotation_matrix() -> None:
    poses = standing(3)
    before = poses.rotations = rotation_y(torch.arange(81.0).view(1, 3, 27)) @ poses.rotations
    angle = torch.tensor([[0.0, 1.2, -3.0]])
    poses.turn_about_up(angle)
    torch.testing.assert_close(poses.rotations, rotation_y(angle)[:, :, None] @ before)
    assert torch.equal(poses.rotations[:, 0], before[:, 0])


def test_a_turn_beyond_half_a_circle_keeps_its_direction() -> None:
    poses = standing(81)
    turn = torch.linspace(0, 5.0, 81)
    face_root(poses, torch.stack([turn.cos(), turn.sin()], dim=-1)[None])
    steps = shown(poses).diff()
    steps = torch.atan2(steps.sin(), steps.cos())
    assert float(steps.max()) < 0.2
    assert float(steps.min()) > -0.02


def test_small_sway_of_the_root_leaves_the_body_unchanged() -> None:
    poses = standing(20)
    before = poses.rotations.clone()
    sway = 0.04 * torch.sin(torch.arange(20.0))
    face_root(poses, torch.stack([sway.cos(), sway.sin()], dim=-1)[None])
    assert torch.allclose(poses.rotations, before, atol=1e-6)
