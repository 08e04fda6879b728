"""Known poses in the axes of game engines: each engine's own coordinates for forward, left and a turn."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motiongen_client import GODOT, ROS, UNITY, UNREAL, Axes
from motiongen_client.kinematics import forward_kinematics, quaternion_to_matrix

HALF = math.sqrt(0.5)
TURNED_LEFT = (HALF, 0, HALF, 0)  # w x y z: a quarter about +Y, from +Z toward +X, which is to the left
BOWED = (HALF, HALF, 0, 0)  # a quarter about +X, from up to forward


@pytest.mark.parametrize(
    ("axes", "one_forward_two_left_three_up"),
    [(UNREAL, (100, -200, 300)), (UNITY, (-2, 3, 1)), (GODOT, (-2, 3, -1)), (ROS, (1, 2, 3))],
)
def test_point_ahead_left_and_above_has_each_engines_coordinates(
    axes: Axes, one_forward_two_left_three_up: tuple[float, ...]
) -> None:
    assert axes.positions((2, 3, 1)) == pytest.approx(one_forward_two_left_three_up)


@pytest.mark.parametrize(
    ("axes", "left_handed", "turned_left"),
    [
        (UNREAL, True, (0, 0, -HALF, HALF)),  # a yaw of -90 degrees: positive yaw is to the right
        (UNITY, True, (0, -HALF, 0, HALF)),  # Quaternion.Euler(0, -90, 0)
        (GODOT, False, (0, HALF, 0, HALF)),  # rotation.y of +90 degrees
        (ROS, False, (0, 0, HALF, HALF)),  # a yaw of +90 degrees
    ],
)
def test_turn_to_the_left_has_each_engines_quaternion(
    axes: Axes, left_handed: bool, turned_left: tuple[float, ...]
) -> None:
    assert axes.is_left_handed is left_handed
    assert axes.quaternions_xyzw(TURNED_LEFT) == pytest.approx(turned_left)


@pytest.mark.parametrize(
    ("axes", "bowed"),
    [
        (UNREAL, (0, HALF, 0, HALF)),  # a pitch of -90 degrees, whose quaternion FRotator gives a positive y
        (UNITY, (HALF, 0, 0, HALF)),  # Quaternion.Euler(90, 0, 0) looks down
        (GODOT, (-HALF, 0, 0, HALF)),  # rotation.x of -90 degrees looks down
        (ROS, (0, HALF, 0, HALF)),  # a pitch of +90 degrees is nose down
    ],
)
def test_bow_has_each_engines_quaternion(axes: Axes, bowed: tuple[float, ...]) -> None:
    turned = axes.quaternions_xyzw(BOWED)
    assert turned == pytest.approx(bowed)


@pytest.mark.parametrize("axes", [UNREAL, UNITY, GODOT, ROS], ids=lambda axes: axes.name)
def test_skeleton_posed_in_engine_axes_has_the_same_joint_positions(axes: Axes) -> None:
    rng = np.random.default_rng(3)
    parents, offsets = (-1, 0, 1, 1), rng.normal(size=(4, 3))
    rotations, root = rng.normal(size=(4, 4)), rng.normal(size=3)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    here, _ = forward_kinematics(parents, offsets, root, rotations)
    there_wxyz = np.roll(axes.quaternions_xyzw(rotations), 1, axis=-1)
    there, _ = forward_kinematics(parents, axes.positions(offsets), axes.positions(root), there_wxyz)
    assert there == pytest.approx(axes.positions(here))


@pytest.mark.parametrize("axes", [UNREAL, UNITY, GODOT, ROS], ids=lambda axes: axes.name)
def test_quaternions_are_converted_as_rotation_matrices_are(axes: Axes) -> None:
    rotation = quaternion_to_matrix(np.array([0.1, 0.7, -0.5, 0.5]))
    quaternion = np.roll(axes.quaternions_xyzw((0.1, 0.7, -0.5, 0.5)), 1)
    assert quaternion_to_matrix(quaternion) == pytest.approx(axes.matrix @ rotation @ axes.matrix.T)
