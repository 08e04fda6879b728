"""Legs solved for goals, planted feet, bent paths, starts, stops and joins."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motiongen_ardy.data.joining import join, nearest, passes, start, stop
from motiongen_ardy.data.leg import MAX_REACH, solve_leg
from motiongen_ardy.data.poses import Poses, global_pose, runs, smooth, yaw_matrix, yaw_of
from motiongen_ardy.data.quality import quality
from motiongen_ardy.data.replant import replant
from motiongen_ardy.data.warp import warp
from tests.ardy.data.walker import CORE, FPS, sliding, standing, walking

THIGH, SHIN = np.array([0.0, -0.41, 0.0]), np.array([0.0, -0.46, 0.0])


def solved_ankle(goal: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, float]:
    """Knee, ankle and shortfall in metres of a straight leg solved for a goal, its hip at the origin."""
    identity = np.eye(3)[None]
    leg = solve_leg(np.zeros((1, 3)), np.array([goal]), identity, identity, THIGH, SHIN)
    knee = leg.thigh[0] @ THIGH
    return knee, knee + leg.shin[0] @ SHIN, float(leg.short_m[0])


@pytest.mark.parametrize("goal", [(0.0, -0.8, 0.0), (0.1, -0.6, 0.4), (-0.2, -0.7, -0.3)])
def test_a_leg_reaches_its_goal_with_the_knee_forward(goal: tuple[float, float, float]) -> None:
    knee, ankle, short = solved_ankle(goal)
    np.testing.assert_allclose(ankle, goal, atol=1e-9)
    assert short == 0
    along = ankle / np.linalg.norm(ankle)
    assert (knee - (knee @ along) * along)[2] > 0.05


def test_a_leg_stretches_towards_a_goal_out_of_reach() -> None:
    _, ankle, short = solved_ankle((0.0, -1.0, 0.0))
    assert np.linalg.norm(ankle) == pytest.approx(MAX_REACH * 0.87)
    assert short == pytest.approx(1.0 - MAX_REACH * 0.87)


def test_planted_feet_stay_and_swinging_feet_are_lifted() -> None:
    raw = sliding(100, 1.0)
    _, positions = global_pose(CORE, *_pair(replant(CORE, raw).poses))
    for side, chain in enumerate((CORE.left_foot, CORE.right_foot)):
        toe = positions[:, chain[1]]
        for first, end in runs(raw.contacts[:, side].any(-1)):
            assert np.ptp(toe[first:end, [0, 2]], axis=0).max() < 1e-3
        swing = positions[12:20, CORE.left_foot[0], 1] if side == 0 else positions[22:30, chain[0], 1]
        assert swing.max() > positions[:, chain[0], 1].min() + 0.03


def test_a_path_can_be_turned_while_the_body_keeps_its_heading() -> None:
    walk = walking()
    frames = walk.num_frames
    quarter = np.full(frames, math.pi / 2)
    made = warp(CORE, walk, FPS, np.zeros(frames), travel=quarter, stride=np.full(frames, 0.4))
    moved = made.poses.root[-1] - made.poses.root[0]
    assert moved[0] == pytest.approx(0.4 * (walk.root[-1, 2] - walk.root[0, 2]), rel=0.02)
    assert abs(moved[2]) < 0.02
    rotations, _ = global_pose(CORE, *_pair(made.poses))
    assert np.abs(yaw_of(rotations[:, 0])).max() < 1e-6


def test_a_bent_path_turns_the_body_without_sliding_feet() -> None:
    walk = walking()
    turn = np.linspace(0, math.pi, walk.num_frames)
    made = warp(CORE, walk, FPS, turn, travel=turn, stride=np.ones(walk.num_frames))
    figures = quality(CORE, made.poses.quaternions, made.poses.root, FPS)
    assert figures.slowest_ratio < 0.02
    rotations, _ = global_pose(CORE, *_pair(made.poses))
    assert yaw_of(rotations[:, 0])[-1] == pytest.approx(math.pi, abs=1e-6)


def test_a_start_lifts_a_foot_before_the_body_moves_and_then_walks() -> None:
    walk, stand = walking(), standing()
    raw, told = start(CORE, stand, walk, passes(CORE, walk)[0], 14)
    made = replant(CORE, raw).poses
    _, positions = global_pose(CORE, *_pair(made))
    assert np.abs(made.root[:told] - made.root[0]).max() < 1e-6
    ankles = positions[:, [CORE.left_foot[0], CORE.right_foot[0]], 1]
    lifted = told + int(np.argmax((ankles[told:] - ankles[told] > 0.02).any(-1)))
    assert np.linalg.norm((made.root[lifted] - made.root[told])[[0, 2]]) < 0.05
    steps = np.linalg.norm(np.diff(made.root[:, [0, 2]], axis=0), axis=-1) * FPS
    assert steps[-20:].mean() == pytest.approx(1.0, abs=0.05)
    assert quality(CORE, made.quaternions, made.root, FPS).slowest_ratio < 0.05


def test_a_stop_ends_at_rest_with_the_feet_side_by_side() -> None:
    walk, stand = walking(), standing()
    raw, told = stop(CORE, walk, stand, passes(CORE, walk)[-1], 14)
    made = replant(CORE, raw).poses
    assert 0 < told < made.num_frames - 40
    assert np.abs(made.root[-40:] - made.root[-1]).max() < 1e-6
    _, positions = global_pose(CORE, *_pair(made))
    apart = positions[-1, CORE.left_foot[0]] - positions[-1, CORE.right_foot[0]]
    assert abs(apart[2]) < 0.05


def test_joined_motions_continue_in_the_direction_of_the_first() -> None:
    first, second = walking(80), walking(80)
    turned = Poses(
        second.quaternions.copy(), (yaw_matrix(np.array(1.0)) @ second.root[..., None])[..., 0], second.contacts
    )
    half = 1.0 / 2
    turned.quaternions[:, 0] = [math.cos(half), 0, math.sin(half), 0]
    i, j, distance = nearest(CORE, first, turned, 12, FPS)
    assert distance < 1e-6
    raw = join(
        CORE, Poses(first.quaternions[: i + 5], first.root[: i + 5], first.contacts[: i + 5]), _from(turned, j - 5), 10
    )
    ahead = raw.root[-1] - raw.root[0]
    assert abs(ahead[0]) < 0.01
    assert ahead[2] == pytest.approx((raw.num_frames - 1) / FPS, rel=0.02)


def test_smoothing_keeps_a_straight_line() -> None:
    line = np.linspace(2.0, 5.0, 40)
    np.testing.assert_allclose(smooth(line, 4.0), line, atol=1e-9)


def _pair(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    return poses.quaternions, poses.root


def _from(poses: Poses, first: int) -> Poses:
    return Poses(poses.quaternions[first:], poses.root[first:], poses.contacts[first:])
