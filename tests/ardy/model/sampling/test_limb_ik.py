"""Two-bone inverse kinematics: targets are met, bones keep their length, limbs stay in their plane and bent."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.core.two_bone import swing
from motiongen_ardy.model.config import ConfigError
from motiongen_ardy.model.sampling.limb_ik import FULL_REACH, bend, soft_reach
from motiongen_ardy.model.sampling.limbs import arms, legs

HIP = torch.zeros(3)
KNEE = torch.tensor([0.0, -0.40, 0.12])
ANKLE = torch.tensor([0.0, -0.84, 0.0])
FORWARD = torch.tensor([0.0, 0.0, 1.0])
LENGTH = float(KNEE.norm() + (ANKLE - KNEE).norm())


def solve(
    target: Tensor, knee: Tensor = KNEE, ankle: Tensor = ANKLE, hinged: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    identity = torch.eye(3)
    return bend((HIP, knee, ankle), (identity, identity), target, FORWARD, hinged)


def test_a_target_within_reach_is_met_and_bones_keep_their_length() -> None:
    target = torch.tensor([0.2, -0.6, 0.3])
    first, second, knee, ankle = solve(target)
    torch.testing.assert_close(ankle, target, atol=1e-5, rtol=0)
    assert knee.norm() == pytest.approx(float(KNEE.norm()), abs=1e-5)
    assert (ankle - knee).norm() == pytest.approx(float((ANKLE - KNEE).norm()), abs=1e-5)
    # The rotations agree with the positions.
    torch.testing.assert_close(first @ KNEE, knee, atol=1e-5, rtol=0)
    torch.testing.assert_close(knee + second @ (ANKLE - KNEE), ankle, atol=1e-5, rtol=0)


def test_a_pose_that_already_meets_its_target_is_left_alone() -> None:
    first, second, knee, ankle = solve(ANKLE)
    for got, expected in ((first, torch.eye(3)), (second, torch.eye(3)), (knee, KNEE), (ankle, ANKLE)):
        torch.testing.assert_close(got, expected, atol=1e-5, rtol=0)


def test_a_target_out_of_reach_leaves_the_limb_bent() -> None:
    *_, ankle = solve(torch.tensor([0.0, -3.0, 0.0]))
    assert 0.98 * LENGTH < ankle.norm() <= FULL_REACH * LENGTH + 1e-6
    assert float(ankle[1]) == pytest.approx(-float(ankle.norm()), abs=1e-6)


def test_the_reach_of_a_limb_saturates_smoothly() -> None:
    distances = torch.linspace(0.9, 1.2, 400)
    slopes = soft_reach(distances, 1.0).diff() / distances.diff()
    assert slopes.diff().abs().max() < 0.1
    assert (slopes >= 0).all()


def test_the_bend_plane_is_kept_when_the_target_lies_in_it() -> None:
    _, _, knee, _ = solve(torch.tensor([0.0, -0.5, -0.2]))
    assert abs(float(knee[0])) < 1e-6
    assert knee[2] > 0


def test_a_straight_leg_bends_forward() -> None:
    _, _, knee, ankle = solve(
        torch.tensor([0.0, -0.7, 0.0]), torch.tensor([0.0, -0.4, 0.0]), torch.tensor([0.0, -0.85, 0.0])
    )
    assert knee[2] > 0.1
    torch.testing.assert_close(ankle, torch.tensor([0.0, -0.7, 0.0]), atol=1e-5, rtol=0)


def test_only_an_overstretched_knee_is_bent_forward() -> None:
    target, hinge = torch.tensor([0.0, -0.75, 0.0]), torch.tensor(1.0)
    places = []
    for ahead in (-0.04, -0.01, -0.001, 0.001, 0.01, 0.04):
        *_, knee, ankle = solve(target, torch.tensor([0.0, -0.4, ahead]), hinged=hinge)
        torch.testing.assert_close(ankle, target, atol=1e-5, rtol=0)
        assert knee[2] > 0.1
        places.append(knee)
    assert float((torch.stack(places)[1:5] - places[0]).norm(dim=-1).max()) < 0.02, (
        "it does not jump where it changes sides"
    )
    torch.testing.assert_close(solve(ANKLE, KNEE, hinged=hinge)[2], KNEE, atol=1e-5, rtol=0)
    assert solve(target, torch.tensor([0.0, -0.4, -0.04]))[2][2] < -0.1, "without a hinge it keeps its side"


def test_a_target_at_the_hip_folds_the_leg_but_not_flat() -> None:
    _, _, knee, ankle = solve(HIP)
    assert knee.isfinite().all()
    assert ankle.norm() > 1e-4


@pytest.mark.parametrize("angle", [0.0, 1e-4, 1.0, 3.0])
def test_a_swing_is_a_rotation_from_one_vector_to_the_other(angle: float) -> None:
    before = torch.tensor([1.0, 0.0, 0.0])
    after = torch.tensor([math.cos(angle), 0.0, math.sin(angle)])
    turn = swing(before, after)
    torch.testing.assert_close(turn @ before, after, atol=1e-5, rtol=0)
    torch.testing.assert_close(turn @ turn.T, torch.eye(3), atol=1e-4, rtol=0)


@pytest.mark.parametrize("name", ["core27", "soma30", "soma77"])
def test_limbs_are_found_by_their_chains(name: str) -> None:
    skeleton = load_skeleton(name)
    assert {limb.upper for limb in legs(skeleton)} == set(skeleton.hip_joints)
    assert [skeleton.joint_names[limb.end] for limb in arms(skeleton)] == ["LeftHand", "RightHand"]


def test_a_robot_without_two_bone_legs_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"g134 has no legs of two bones.*set clean_feet"):
        legs(load_skeleton("g134"))
