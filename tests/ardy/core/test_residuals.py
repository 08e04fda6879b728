"""Residuals: zero for motion that meets its constraints, and the right size for motion that misses them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.residuals import Residual, residuals
from motiongen_ardy.core.rotation import rotation_y
from motiongen_ardy.core.skeleton import Skeleton, load_skeleton, skeleton_names
from motiongen_ardy.formats.constraints import PoseConstraint, RootConstraint, constraint_targets, pose_constraint
from tests.ardy.formats.motions import random_motion
from tests.pretend_device import AWAY, pretended

CORE = load_skeleton("core27")
MOTION = random_motion(CORE, 12, seed=0).motion


def moved(motion: Motion, by: tuple[float, float, float]) -> Motion:
    return Motion(motion.local_rotations, motion.root_positions + torch.tensor(by), motion.foot_contacts, motion.fps)


def one(motion: Motion, constraint: RootConstraint | PoseConstraint, first_frame: int = 0) -> Residual:
    (measured,) = residuals(motion, [constraint_targets(CORE, [constraint])], first_frame)
    return measured


def test_motion_on_another_device_has_the_same_residuals() -> None:
    constraint = pose_constraint(moved(MOTION, (0.5, 0, 0)), [3, 7])
    with pretended():
        parts = (MOTION.local_rotations, MOTION.root_positions, MOTION.foot_contacts)
        measured = one(Motion(*(part.to(AWAY) for part in parts), MOTION.fps), constraint)
    assert measured == one(MOTION, constraint)


@pytest.mark.parametrize("limbs", [None, ("LeftHand", "Hips"), ("RightFoot", "LeftHand", "Hips")])
@pytest.mark.parametrize("name", skeleton_names())
def test_motion_that_meets_a_pose_constraint_has_no_residual(name: str, limbs: tuple[str, ...] | None) -> None:
    skeleton: Skeleton = load_skeleton(name)
    motion = random_motion(skeleton, 12, seed=2).motion
    targets = constraint_targets(skeleton, [pose_constraint(motion, [3, 7], limbs)])
    (measured,) = residuals(motion, [targets])
    assert measured.num_frames == 2
    assert measured.position_m is not None
    assert measured.position_m.worst < 1e-4
    assert measured.heading_rad is not None
    assert measured.heading_rad.worst < 1e-4
    assert (measured.rotation_rad is None) == (limbs is None)
    assert measured.rotation_rad is None or measured.rotation_rad.worst < 1e-4


@settings(max_examples=30, deadline=None)
@given(x=st.floats(-3, 3), y=st.floats(-3, 3), z=st.floats(-3, 3))
def test_the_position_residual_is_the_distance_from_the_target(x: float, y: float, z: float) -> None:
    pose = one(moved(MOTION, (x, y, z)), pose_constraint(MOTION, [5]))
    assert pose.position_m is not None
    distance = math.hypot(x, y, z)
    assert pose.position_m.mean == pytest.approx(distance, abs=1e-4)
    assert pose.position_m.worst == pytest.approx(distance, abs=1e-4)
    waypoint = one(moved(MOTION, (x, y, z)), RootConstraint((5,), MOTION.root_positions[[5]][:, [0, 2]]))
    assert waypoint.position_m is not None
    assert waypoint.position_m.worst == pytest.approx(math.hypot(x, z), abs=1e-4), "a waypoint leaves height free"
    assert (waypoint.heading_rad, waypoint.rotation_rad) == (None, None)


@settings(max_examples=30, deadline=None)
@given(turn=st.floats(-math.pi, math.pi))
def test_a_turned_character_has_the_turn_as_heading_and_rotation_residual(turn: float) -> None:
    turned = MOTION.local_rotations.clone()
    turned[:, 0] = rotation_y(torch.tensor(turn)) @ turned[:, 0]
    motion = Motion(turned, MOTION.root_positions, MOTION.foot_contacts, MOTION.fps)
    measured = one(motion, pose_constraint(MOTION, [5], ("LeftHand", "Hips")))
    assert measured.heading_rad is not None
    assert measured.heading_rad.worst == pytest.approx(abs(turn), abs=1e-3)
    assert measured.rotation_rad is not None
    assert measured.rotation_rad.mean == pytest.approx(abs(turn), abs=1e-3)


@pytest.mark.parametrize("limbs", [None, ("LeftHand", "Hips"), ("LeftHand",)])
def test_a_pose_at_a_shifted_ground_position_is_measured_there(limbs: tuple[str, ...] | None) -> None:
    pose = pose_constraint(MOTION, [5])
    there = MOTION.root_positions[[5]][:, [0, 2]] + torch.tensor([2.0, -1.0])
    elsewhere = PoseConstraint(pose.frames, pose.rotation_vectors, pose.root_positions, limbs, there)
    reached = one(moved(MOTION, (2.0, 0.0, -1.0)), elsewhere)
    assert reached.position_m is not None
    assert reached.position_m.worst < 1e-4
    missed = one(MOTION, elsewhere)
    assert missed.position_m is not None
    assert missed.position_m.mean == pytest.approx(math.sqrt(5), abs=1e-4)


def test_frames_are_absolute_and_those_outside_the_motion_are_ignored() -> None:
    waypoint = RootConstraint((99, 102, 500), MOTION.root_positions[[0, 2, 3]][:, [0, 2]])
    measured = one(MOTION, waypoint, first_frame=100)
    assert measured.num_frames == 1
    assert measured.position_m is not None
    assert measured.position_m.worst < 1e-6
    assert one(MOTION, waypoint, first_frame=1000) == Residual(0, None, None, None)


def test_constraints_are_measured_separately_and_in_order() -> None:
    near = MOTION.root_positions[[5]][:, [0, 2]]
    parts = [RootConstraint((5,), near + torch.tensor([[1.0, 0.0]])), RootConstraint((5,), near)]
    first, second = residuals(MOTION, [constraint_targets(CORE, [part]) for part in parts])
    assert first.position_m is not None
    assert first.position_m.worst == pytest.approx(1, abs=1e-5)
    assert second.position_m is not None
    assert second.position_m.worst < 1e-6


def test_a_joint_target_without_a_root_is_measured_in_the_world() -> None:
    targets = Targets(CORE)
    hand = CORE.left_hand[0]
    targets.positions[5, hand] = MOTION.positions(CORE)[5, hand].numpy() + np.array([0.0, 0.25, 0.0], np.float32)
    (measured,) = residuals(MOTION, [targets])
    assert measured.position_m is not None
    assert measured.position_m.worst == pytest.approx(0.25, abs=1e-5)
