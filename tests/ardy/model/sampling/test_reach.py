"""Joint goals: they are met at their frames, distant frames do not change, and goals out of reach are missed."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import axis_angle_to_matrix, rotation_vector
from motiongen_ardy.core.skeleton import forward_kinematics, global_to_local
from motiongen_ardy.model.sampling.correct import correct_window
from motiongen_ardy.model.sampling.options import SamplingOptions
from tests.ardy.model.sampling.conftest import Stand

REACH = SamplingOptions(reach_joints=True)
BOTH = SamplingOptions(reach_joints=True, clean_feet=True)
FIRST = 100  # the first new frame
GOAL = 20  # the frame of most goals, counted from FIRST


def reached(
    layout: Representation, features: Tensor, targets: Targets, options: SamplingOptions = REACH
) -> tuple[Tensor, Tensor]:
    """World positions (T, J, 3) and global rotations of the new frames; features: (1, 1 + T, D), history first."""
    observed, mask = (part[None] for part in targets.observe(layout, FIRST, features.shape[1] - 1))
    new = correct_window(layout, features[:, :1], features[:, 1:], (observed, mask), options)
    natural = layout.denormalize(new)
    return layout.positions(natural)[0], layout.global_rotations(natural)[0]


def standing(layout: Representation, stand: Stand) -> tuple[Tensor, Tensor]:
    """Features (1, 41, D) and the world positions of one frame."""
    features = stand(torch.zeros(41, 3))
    return features, layout.positions(layout.denormalize(features))[0, 0]


@pytest.mark.parametrize("options", [REACH, BOTH])
@pytest.mark.parametrize(
    ("joint", "move"),
    [
        ("LeftHand", (-0.05, 0.25, 0.2)),
        ("RightHandEnd", (0.1, 0.2, 0.25)),
        ("RightFoot", (0.0, 0.15, 0.2)),
        ("LeftToeBase", (0.05, 0.1, 0.1)),
    ],
)
def test_a_hand_or_foot_goal_is_met_and_distant_frames_stay_at_rest(
    layout: Representation, stand: Stand, joint: str, move: tuple[float, float, float], options: SamplingOptions
) -> None:
    features, pose = standing(layout, stand)
    index = layout.skeleton.index(joint)
    targets = Targets(layout.skeleton)
    asked = pose[index] + torch.tensor(move)
    targets.add_joints(FIRST + GOAL, [0, index], torch.stack([pose[0], asked]))
    positions, _ = reached(layout, features, targets, options)
    assert (positions[GOAL, index] - asked).norm() < 2e-3
    far = torch.cat([positions[: GOAL - 9], positions[GOAL + 9 :]])
    assert (far - pose).norm(dim=-1).max() < 0.02
    acceleration = positions.diff(dim=0).diff(dim=0).norm(dim=-1).max() * 400
    assert acceleration < 45


def test_a_head_rotation_is_met_and_turns_the_neck_along(layout: Representation, stand: Stand) -> None:
    features, _ = standing(layout, stand)
    head, neck = layout.skeleton.index("Head"), layout.skeleton.index("Neck")
    asked = axis_angle_to_matrix(torch.tensor([0.0, 0.9, 0.2]))
    targets = Targets(layout.skeleton)
    targets.add_rotations(FIRST + GOAL, [head], asked[None])
    _, rotations = reached(layout, features, targets)
    assert rotation_vector(asked.T @ rotations[GOAL, head]).norm() < 1e-3
    assert rotation_vector(rotations[GOAL, neck]).norm() == pytest.approx(0.5 * 0.922, abs=0.02)
    assert rotation_vector(rotations[GOAL + 10, head]).norm() < 1e-3


def test_a_root_height_is_met_while_the_feet_stay(layout: Representation, stand: Stand) -> None:
    features, pose = standing(layout, stand)
    targets = Targets(layout.skeleton)
    targets.height[FIRST + GOAL] = np.float32(pose[0, 1]) - np.float32(0.2)
    positions, _ = reached(layout, features, targets, BOTH)
    assert float(positions[GOAL, 0, 1]) == pytest.approx(float(pose[0, 1]) - 0.2, abs=1e-4)
    ankles = [layout.skeleton.left_foot[0], layout.skeleton.right_foot[0]]
    assert (positions[:, ankles] - pose[ankles]).norm(dim=-1).max() < 0.01


@pytest.mark.parametrize("options", [REACH, BOTH])
def test_a_keyframe_is_met_at_every_joint(layout: Representation, stand: Stand, options: SamplingOptions) -> None:
    features, _ = standing(layout, stand)
    natural = layout.denormalize(features)[0, 0]
    local = global_to_local(layout.skeleton, layout.global_rotations(natural))
    draw = torch.Generator().manual_seed(3)
    turned = local @ axis_angle_to_matrix(0.25 * torch.randn(27, 3, generator=draw))
    _, asked = forward_kinematics(layout.skeleton, turned, natural[:3] - torch.tensor([0.0, 0.03, 0.0]))
    targets = Targets(layout.skeleton)
    targets.add_keyframes([FIRST + GOAL], asked[None])
    positions, _ = reached(layout, features, targets, options)
    assert (positions[GOAL] - asked).norm(dim=-1).max() < 5e-3


def test_a_position_goal_of_the_head_is_met(layout: Representation, stand: Stand) -> None:
    features, pose = standing(layout, stand)
    head, base = layout.skeleton.index("Head"), layout.skeleton.index("Spine")
    lean = axis_angle_to_matrix(torch.tensor([0.4, 0.0, 0.1]))
    asked = pose[base] + lean @ (pose[head] - pose[base])
    targets = Targets(layout.skeleton)
    targets.add_joints(FIRST + GOAL, [0, head], torch.stack([pose[0], asked]))
    positions, rotations = reached(layout, features, targets)
    assert (positions[GOAL, head] - asked).norm() < 1e-3
    before, after = pose[head] - pose[base], asked - pose[base]
    angle = torch.acos(before @ after / (before.norm() * after.norm()))
    assert angle > 0.4
    for joint in (base, layout.skeleton.index("Neck"), head):
        assert rotation_vector(rotations[GOAL, joint]).norm() == pytest.approx(float(angle), abs=1e-3)
    legs = [0, *layout.skeleton.left_foot, *layout.skeleton.right_foot]
    assert (positions[:, legs] - pose[legs]).norm(dim=-1).max() < 1e-3
    assert rotation_vector(rotations[GOAL + 10, base]).norm() < 1e-3


def test_goals_for_elbow_and_hand_at_one_frame_are_both_met(layout: Representation, stand: Stand) -> None:
    features, pose = standing(layout, stand)
    shoulder, elbow, hand = (layout.skeleton.index(f"Left{name}") for name in ("Arm", "ForeArm", "Hand"))
    upper = axis_angle_to_matrix(torch.tensor([0.3, 0.5, -0.8]))
    lower = axis_angle_to_matrix(torch.tensor([0.0, -1.0, 0.0])) @ upper
    at_elbow = pose[shoulder] + upper @ (pose[elbow] - pose[shoulder])
    at_hand = at_elbow + lower @ (pose[hand] - pose[elbow])
    targets = Targets(layout.skeleton)
    targets.add_joints(FIRST + GOAL, [0, elbow, hand], torch.stack([pose[0], at_elbow, at_hand]))
    positions, _ = reached(layout, features, targets)
    assert (positions[GOAL, [elbow, hand]] - torch.stack([at_elbow, at_hand])).norm(dim=-1).max() < 5e-3


def test_a_goal_out_of_reach_is_missed_with_a_slightly_bent_arm(layout: Representation, stand: Stand) -> None:
    features, pose = standing(layout, stand)
    shoulder, elbow, hand = (layout.skeleton.index(f"Left{name}") for name in ("Arm", "ForeArm", "Hand"))
    targets = Targets(layout.skeleton)
    asked = pose[shoulder] + torch.tensor([0.5, 0.5, 2.0])
    targets.add_joints(FIRST + GOAL, [0, hand], torch.stack([pose[0], asked]))
    positions, _ = reached(layout, features, targets)
    arm = positions[GOAL, hand] - positions[GOAL, shoulder]
    assert arm.norm() < 0.996 * ((pose[elbow] - pose[shoulder]).norm() + (pose[hand] - pose[elbow]).norm())
    assert (arm / arm.norm() * (asked - pose[shoulder]) / (asked - pose[shoulder]).norm()).sum() > 0.999


def test_a_goal_soon_after_the_history_respects_the_acceleration_limit(layout: Representation, stand: Stand) -> None:
    features, pose = standing(layout, stand)
    hand = layout.skeleton.index("LeftHand")
    asked = pose[hand] + torch.tensor([0.0, 0.3, 0.2])
    for frame in (0, 1, 3):
        targets = Targets(layout.skeleton)
        targets.add_joints(FIRST + frame, [0, hand], torch.stack([pose[0], asked]))
        positions, _ = reached(layout, features, targets)
        path = torch.cat([pose[None, hand], pose[None, hand], positions[:, hand]])
        assert path.diff(dim=0).diff(dim=0).norm(dim=-1).max() * 400 < 60
        missed = (positions[frame, hand] - asked).norm()
        assert 0.01 < missed < (pose[hand] - asked).norm()


def test_rows_without_goals_do_not_change(layout: Representation, stand: Stand) -> None:
    features, pose = standing(layout, stand)
    hand = layout.skeleton.index("LeftHand")
    targets = Targets(layout.skeleton)
    targets.add_joints(FIRST + GOAL, [0, hand], torch.stack([pose[0], pose[hand] + 0.1]))
    observed, mask = targets.observe(layout, FIRST, 40)
    rows = features.repeat(2, 1, 1)
    goals = torch.stack([torch.zeros_like(observed), observed]), torch.stack([torch.zeros_like(mask), mask])
    new = correct_window(layout, rows[:, :1], rows[:, 1:], goals, REACH)
    first = layout.positions(layout.denormalize(new))[0]
    assert (first - pose).norm(dim=-1).max() < 1e-4


@pytest.mark.parametrize("frame", [0, 1, 4])
def test_without_a_history_early_goals_are_met(layout: Representation, stand: Stand, frame: int) -> None:
    features, pose = standing(layout, stand)
    hand, head = layout.skeleton.index("LeftHand"), layout.skeleton.index("Head")
    asked, turned = pose[hand] + torch.tensor([0.0, 0.3, 0.2]), axis_angle_to_matrix(torch.tensor([0.0, 0.8, 0.0]))
    targets = Targets(layout.skeleton)
    targets.add_joints(FIRST + frame, [0, hand], torch.stack([pose[0] - torch.tensor([0.0, 0.1, 0.0]), asked]))
    targets.add_rotations(FIRST + frame, [head], turned[None])
    observed, mask = (part[None] for part in targets.observe(layout, FIRST, 40))
    natural = layout.denormalize(correct_window(layout, features[:, :0], features[:, 1:], (observed, mask), BOTH))
    positions, rotations = layout.positions(natural)[0, frame], layout.global_rotations(natural)[0, frame]
    assert (positions[hand] - asked).norm() < 3e-3
    assert float(positions[0, 1]) == pytest.approx(float(pose[0, 1]) - 0.1, abs=1e-3)
    assert rotation_vector(turned.T @ rotations[head]).norm() < 1e-3
