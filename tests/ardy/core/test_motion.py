"""Concatenated motion, and skeletons that all callers share."""

from __future__ import annotations

import pytest
import torch

from motiongen_ardy.core.motion import Motion, concatenate
from motiongen_ardy.core.skeleton import JointsMismatch, forward_kinematics, load_skeleton
from tests.ardy.formats.motions import random_motion

WALK = random_motion(load_skeleton("core27"), 5, seed=1, fps=20).motion


def test_parts_of_one_frame_rate_are_concatenated() -> None:
    whole = concatenate([WALK.frames(0, 2), WALK.frames(2, 5)])
    assert whole.fps == 20
    assert torch.equal(whole.root_positions, WALK.root_positions)


def test_parts_of_different_frame_rates_are_refused() -> None:
    faster = Motion(WALK.local_rotations, WALK.root_positions, WALK.foot_contacts, 30)
    with pytest.raises(ValueError, match="parts of 20, 30 frames a second; resample them"):
        concatenate([WALK, faster])


def test_rotations_of_more_joints_than_the_skeleton_has_are_refused() -> None:
    robot = load_skeleton("g134")
    with pytest.raises(JointsMismatch, match="rotations of 34 joints; the skeleton core27 has 27"):
        forward_kinematics(load_skeleton("core27"), torch.eye(3).expand(1, robot.num_joints, 3, 3), torch.zeros(1, 3))


def test_arrays_of_a_shared_skeleton_are_read_only() -> None:
    skeleton = load_skeleton("core27")
    for places in (skeleton.neutral_joints, skeleton.offsets):
        with pytest.raises(ValueError, match="read-only"):
            places *= 100
