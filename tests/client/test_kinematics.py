"""Forward kinematics against poses worked out by hand, and against a second way of computing it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_client import Motion, Rig
from motiongen_client.kinematics import forward_kinematics, heading_rad, quaternion_to_matrix

HALF = np.sqrt(0.5)


def test_joint_positions_of_the_neutral_pose_are_sums_of_offsets(stick_rig: Rig) -> None:
    rest = np.tile([1.0, 0, 0, 0], (9, 1))
    positions, rotations = forward_kinematics(stick_rig.parents, stick_rig.offsets_m, np.array([1.0, 0.9, 2]), rest)
    np.testing.assert_allclose(positions[stick_rig.index("LeftHand")], [1.7, 1.4, 2], atol=1e-6)
    np.testing.assert_allclose(rotations, np.tile(np.eye(3), (9, 1, 1)), atol=1e-12)


def test_quarter_turn_of_the_root_turns_the_heading_to_the_left(stick_rig: Rig) -> None:
    """+90 degrees about +Y: facing +X, so the left hand, which was at +X, is at -Z."""
    pose = np.tile([1.0, 0, 0, 0], (9, 1))
    pose[0] = [HALF, 0, HALF, 0]
    positions, rotations = forward_kinematics(stick_rig.parents, stick_rig.offsets_m, np.zeros(3), pose)
    np.testing.assert_allclose(positions[stick_rig.index("LeftHand")], [0, 0.5, -0.7], atol=1e-6)
    assert heading_rad(rotations[0]) == pytest.approx(np.pi / 2)


def test_rotated_arm_moves_its_own_hand_only(stick_rig: Rig) -> None:
    pose = np.tile([1.0, 0, 0, 0], (9, 1))
    pose[stick_rig.index("LeftArm")] = [HALF, 0, 0, HALF]  # +90 degrees about +Z: +X goes up
    positions, _ = forward_kinematics(stick_rig.parents, stick_rig.offsets_m, np.zeros(3), pose)
    np.testing.assert_allclose(positions[stick_rig.index("LeftHand")], [0.2, 1.0, 0], atol=1e-6)
    np.testing.assert_allclose(positions[stick_rig.index("RightHand")], [-0.7, 0.5, 0], atol=1e-6)


@given(values=st.lists(st.floats(-1, 1), min_size=7, max_size=7).filter(lambda v: np.linalg.norm(v[:4]) > 0.1))
def test_matrix_of_a_quaternion_rotates_vectors_as_the_quaternion_does(values: list[float]) -> None:
    """v' = v + 2 w (u x v) + 2 u x (u x v) for the unit quaternion (w, u)."""
    quaternion, vector = np.array(values[:4]), np.array(values[4:])
    w, *axis = quaternion / np.linalg.norm(quaternion)
    cross = np.cross(axis, vector)
    expected = vector + 2 * w * cross + 2 * np.cross(axis, cross)
    np.testing.assert_allclose(quaternion_to_matrix(quaternion) @ vector, expected, atol=1e-12)


def test_bones_keep_their_length(stick_rig: Rig) -> None:
    random = np.random.default_rng(3)
    rows = random.normal(size=(5, stick_rig.row_width)).astype(np.float32)
    positions = Motion(stick_rig, 0, rows).joint_positions_m()
    bones = positions[:, 1:] - positions[:, list(stick_rig.parents[1:])]
    lengths = np.tile(np.linalg.norm(stick_rig.offsets_m[1:], axis=-1), (5, 1))
    np.testing.assert_allclose(np.linalg.norm(bones, axis=-1), lengths, rtol=1e-4)


def test_joint_positions_of_one_frame_equal_those_of_the_motion(stick_motion: Motion) -> None:
    np.testing.assert_allclose(stick_motion.frame(7).joint_positions_m(), stick_motion.joint_positions_m()[7])
