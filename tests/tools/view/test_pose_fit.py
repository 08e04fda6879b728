"""Rotations fitted to joint positions reproduce these positions, and a limb reaches its target."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_client.kinematics import axis_angle_to_quaternion, quaternion_to_matrix
from motiongen_client.motion import Rig
from motiongen_tools.view.pose_fit import axis_angles, fitted, pose, reached, to_local

# hips with two legs and a spine, an arm of two bones with a hand
RIG = Rig(
    "small", ("Hips", "LeftLeg", "LeftFoot", "RightLeg", "RightFoot", "Spine", "Arm", "ForeArm", "Hand"),
    (-1, 0, 1, 0, 3, 0, 5, 6, 7),
    np.array(
        [[0, 0, 0], [0.1, 0, 0], [0, -0.8, 0], [-0.1, 0, 0], [0, -0.8, 0], [0, 0.4, 0], [-0.2, 0.1, 0], [-0.3, 0, 0],
         [-0.25, 0, 0]], np.float32,
    ),
    20, {"root_translation_m": 3, "joint_rotation_quat_wxyz": 36, "foot_contact": 4},
)  # fmt: skip
SEEDS = st.integers(0, 2**32 - 1)


def some_pose(seed: int, most_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Root and local rotations, each about some axis."""
    draw = np.random.default_rng(seed)
    axes = draw.normal(size=(RIG.num_joints, 3))
    angles = draw.uniform(0, most_rad, (RIG.num_joints, 1))
    vectors = axes / np.linalg.norm(axes, axis=-1, keepdims=True) * angles
    return draw.normal(size=3), quaternion_to_matrix(axis_angle_to_quaternion(vectors))


@settings(max_examples=40, deadline=None)
@given(SEEDS, SEEDS)
def test_a_pose_is_recovered_from_its_joint_positions(seed: int, other: int) -> None:
    root, local = some_pose(seed, 1.5)
    places, rotations = pose(RIG, root, local)
    like = pose(RIG, root, some_pose(other, 1.5)[1])[1]
    found, _ = pose(RIG, root, to_local(RIG, fitted(RIG, places, like)))
    np.testing.assert_allclose(found, places, atol=1e-6)
    np.testing.assert_allclose(fitted(RIG, places, rotations), rotations, atol=1e-6)  # no bone turns about itself


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_axis_angles_represent_the_rotation(seed: int) -> None:
    _, local = some_pose(seed, 3.1)
    again = quaternion_to_matrix(axis_angle_to_quaternion(axis_angles(local)))
    np.testing.assert_allclose(again, local, atol=1e-9)


def test_a_hand_reaches_a_place_near_and_stretches_towards_one_too_far() -> None:
    root, local = np.zeros(3), np.tile(np.eye(3), (RIG.num_joints, 1, 1))
    place = np.array([-0.45, 0.6, 0.2])
    bent = reached(RIG, root, local, 8, place)
    places, _ = pose(RIG, root, bent)
    np.testing.assert_allclose(places[8], place, atol=1e-3)
    np.testing.assert_allclose(places[:6], pose(RIG, root, local)[0][:6], atol=1e-12)  # the rest stays
    stretched, _ = pose(RIG, root, reached(RIG, root, local, 8, np.array([-3.0, 0.5, 0.0])))
    np.testing.assert_allclose(np.linalg.norm(stretched[8] - stretched[6]), 0.55, atol=1e-3)
