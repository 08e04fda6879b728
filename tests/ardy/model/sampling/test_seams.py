"""Seams: a limb that a window begins elsewhere moves there smoothly; motion that continues is left alone."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import axis_angle_to_matrix, rotation_vector
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics, global_to_local
from motiongen_ardy.model.sampling.options import JoinOptions
from motiongen_ardy.model.sampling.seams import settle_seam

OPTIONS = JoinOptions()


@pytest.fixture(scope="module")
def skeleton(layout: Representation) -> Skeleton:
    return layout.skeleton


def posed(skeleton: Skeleton, angles: Tensor) -> Tensor:
    """Global rotations (B, T, J, 3, 3) of figures that stand with the left arm turned by `angles` (B, T) about +Z."""
    local = torch.eye(3).expand(*angles.shape, skeleton.num_joints, 3, 3).clone()
    local[:, :, skeleton.index("LeftArm")] = axis_angle_to_matrix(angles[..., None] * torch.tensor([0.0, 0.0, 1.0]))
    return forward_kinematics(skeleton, local, torch.zeros(*angles.shape, 3))[0]


def arm_angles(skeleton: Skeleton, rotations: Tensor) -> Tensor:
    return rotation_vector(global_to_local(skeleton, rotations)[:, :, skeleton.index("LeftArm")])[..., 2]


def test_an_arm_that_starts_elsewhere_moves_there_smoothly(skeleton: Skeleton) -> None:
    history, new = posed(skeleton, torch.zeros(1, 2)), posed(skeleton, torch.full((1, 40), 2.0))
    angles = torch.cat([torch.zeros(1), arm_angles(skeleton, settle_seam(skeleton, history, new, OPTIONS))[0]])
    assert abs(float(angles[1])) < OPTIONS.free_rad + 0.01
    assert float(angles.diff().abs().max()) < 0.4  # unsettled: 2 rad in one frame
    torch.testing.assert_close(angles[2 * OPTIONS.settle_frames + 1 :], torch.full((12,), 2.0))


def test_an_arm_that_was_at_rest_accelerates_gently(skeleton: Skeleton) -> None:
    raised = (0.25 * torch.arange(40.0)).clamp(max=2.0)[None]
    history, new = posed(skeleton, torch.zeros(1, 2)), posed(skeleton, raised)
    angles = torch.cat([torch.zeros(2), arm_angles(skeleton, settle_seam(skeleton, history, new, OPTIONS))[0]])
    speeds = angles.diff()
    assert float(speeds.diff()[:7].abs().max()) < 0.12  # unsettled: from rest to 0.25 rad a frame
    assert float(speeds.min()) > -OPTIONS.free_start_rad
    torch.testing.assert_close(angles[OPTIONS.settle_frames + 3 :], raised[0, OPTIONS.settle_frames + 1 :])


def test_legs_and_arms_after_one_frame_of_history_may_start_at_once(skeleton: Skeleton) -> None:
    local = torch.eye(3).expand(1, 42, skeleton.num_joints, 3, 3).clone()
    swing = (0.15 * torch.arange(40.0)).clamp(max=1.0)
    turn = axis_angle_to_matrix(swing[:, None] * torch.tensor([1.0, 0.0, 0.0]))
    local[0, 2:, skeleton.index("LeftUpLeg")] = turn
    frames = forward_kinematics(skeleton, local, torch.zeros(1, 42, 3))[0]
    assert torch.equal(settle_seam(skeleton, frames[:, :2], frames[:, 2:], OPTIONS), frames[:, 2:])
    arm = posed(skeleton, swing[None])
    assert torch.equal(settle_seam(skeleton, posed(skeleton, torch.zeros(1, 1)), arm, OPTIONS), arm)


def test_motion_that_continues_the_history_is_left_alone(skeleton: Skeleton) -> None:
    swing = 0.3 * torch.arange(42.0)[None] / 4
    frames = posed(skeleton, swing)
    new = frames[:, 2:]
    assert settle_seam(skeleton, frames[:, :2], new, OPTIONS) is new


def test_rows_are_settled_independently_of_each_other(skeleton: Skeleton) -> None:
    history = posed(skeleton, torch.zeros(2, 2))
    new = posed(skeleton, torch.tensor([[2.0], [0.0]]).expand(2, 40).clone())
    both = settle_seam(skeleton, history, new, OPTIONS)
    torch.testing.assert_close(both[:1], settle_seam(skeleton, history[:1], new[:1], OPTIONS))
    assert torch.equal(both[1], new[1])


def test_without_a_history_nothing_is_settled(skeleton: Skeleton) -> None:
    new = posed(skeleton, torch.full((1, 8), 2.0))
    assert settle_seam(skeleton, new[:, :0], new, OPTIONS) is new
