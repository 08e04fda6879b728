"""Trajectories for a controller: angles in range, continuous quaternions, any rate, and a report of the changes."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.core.rotation import quaternion_to_matrix, rotation_vector
from motiongen_ardy.robot.g1 import RobotError, load_g1, qpos_to_motion
from motiongen_ardy.robot.trajectory import (
    clamp_to_range,
    continuous_signs,
    controller_trajectory,
    motion_trajectory,
    relative_rotation,
    resample_qpos,
    velocities,
)
from tests.ardy.robot.poses import random_qpos, walking_qpos

ROBOT = load_g1()
KNEE = 7 + ROBOT.hinges.index("left_knee")
SHOULDER = 7 + ROBOT.hinges.index("left_shoulder_pitch")


def test_a_turn_between_two_poses_is_the_short_one_whichever_sign_their_quaternions_have() -> None:
    start, end = (random_qpos(20, seed)[:, 3:7] for seed in (1, 2))
    turn = relative_rotation(start, end)
    assert turn.norm(dim=1).max() <= math.pi + 1e-9
    expected = quaternion_to_matrix(start).transpose(-1, -2) @ quaternion_to_matrix(end)
    torch.testing.assert_close(turn, rotation_vector(expected), atol=1e-6, rtol=0)
    torch.testing.assert_close(relative_rotation(start, -end), turn)
    torch.testing.assert_close(relative_rotation(-start, end), turn)


def test_angles_out_of_range_are_clamped_and_counted() -> None:
    qpos = walking_qpos(6, 25)
    qpos[2:4, KNEE] = torch.tensor([-0.5, -0.2])
    kept, clamped = clamp_to_range(qpos)
    assert [(one.joint, one.frames, one.num_frames) for one in clamped] == [("left_knee", 2, 6)]
    assert clamped[0].worst == pytest.approx(0.5 - 0.087267)
    assert kept[2:4, KNEE].tolist() == pytest.approx([-0.087267, -0.087267])
    kept[2:4, KNEE] = qpos[2:4, KNEE]
    assert torch.equal(kept[:, :7], qpos[:, :7])
    torch.testing.assert_close(kept, qpos)


def test_an_angle_is_clamped_to_the_end_of_its_range_nearer_on_the_circle() -> None:
    """The left shoulder's range ends at 2.6704; others write 3.0 as -3.283, which must not become -3.0892."""
    qpos = walking_qpos(2, 25)
    qpos[:, SHOULDER] = torch.tensor([2.7, 2.7 - 2 * math.pi])
    assert clamp_to_range(qpos)[0][:, SHOULDER].tolist() == pytest.approx([2.6704, 2.6704])


@pytest.mark.parametrize(("angle", "end"), [(4.5, 2.8798), (4.6, -0.087267)])
def test_half_way_round_from_the_middle_of_its_range_the_other_end_is_nearer(angle: float, end: float) -> None:
    """The left knee's range, -0.087 to 2.880, has its middle at 1.396; half a turn from there is 4.538."""
    qpos = walking_qpos(1, 25)
    qpos[:, KNEE] = angle
    assert clamp_to_range(qpos)[0][:, KNEE].tolist() == pytest.approx([end], abs=1e-4)


def test_an_angle_written_with_whole_turns_more_or_less_is_the_same_angle() -> None:
    qpos = walking_qpos(7, 25)
    qpos[:, SHOULDER] = 0.5 + 2 * math.pi * torch.arange(-3, 4)
    kept, clamped = clamp_to_range(qpos)
    assert clamped == ()
    assert kept[:, SHOULDER].tolist() == pytest.approx([0.5] * 7)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_quaternions_keep_their_rotation_and_their_sign_is_continuous(seed: int) -> None:
    random = torch.Generator().manual_seed(seed)
    quaternions = torch.randn(20, 4, generator=random, dtype=torch.float64)
    smooth = continuous_signs(quaternions)
    assert smooth[0, 0] >= 0
    assert ((smooth[1:] * smooth[:-1]).sum(-1) >= 0).all()
    assert torch.equal(smooth.abs(), quaternions.abs())
    torch.testing.assert_close(quaternion_to_matrix(smooth), quaternion_to_matrix(quaternions))


@pytest.mark.parametrize(("rate_hz", "num_rows"), [(25, 26), (50, 51), (500, 501), (20, 21), (60, 61), (12.5, 13)])
def test_a_resampled_trajectory_follows_the_same_path(rate_hz: float, num_rows: int) -> None:
    trajectory, report = controller_trajectory(walking_qpos(26, 25), 25, rate_hz)
    expected = walking_qpos(num_rows, rate_hz)
    torch.testing.assert_close(trajectory.time_s, torch.arange(num_rows, dtype=torch.float64) / rate_hz)
    torch.testing.assert_close(trajectory.qpos, expected, atol=4e-3, rtol=0)  # straight lines between 25 Hz samples
    assert report.lines == ()


def test_resampling_keeps_the_given_rows_and_turns_evenly_between_them() -> None:
    qpos = walking_qpos(11, 25)
    finer = resample_qpos(qpos, 25, 100)
    torch.testing.assert_close(finer[::4], qpos)
    turns = velocities(finer, 100)[:, 3:6]
    torch.testing.assert_close(turns, torch.tensor([0.0, 0.0, 0.4], dtype=torch.float64).expand_as(turns))


def test_velocities_of_the_root_in_the_world_and_of_the_hinges() -> None:
    qpos = walking_qpos(50, 25)
    qvel = velocities(qpos, 25)
    assert qvel[:, 0].tolist() == pytest.approx([0.6] * 50)
    assert torch.equal(qvel[-1], qvel[-2])
    speed = 0.4 * 2 * math.pi * 0.8
    assert qvel[:, 6].abs().max() == pytest.approx(speed, rel=0.02)
    assert torch.equal(velocities(qpos[:1], 25), torch.zeros(1, 35, dtype=torch.float64))


def test_speeds_beyond_the_robots_limits_are_reported() -> None:
    qpos = walking_qpos(5, 25)
    qpos[2, KNEE] = 2.0
    _, report = controller_trajectory(qpos, 25)
    (fast,) = report.too_fast
    assert (fast.joint, fast.unit) == ("left_knee", "rad/s")
    steps = (qpos[1:, KNEE] - qpos[:-1, KNEE]).abs()
    assert fast.worst == pytest.approx(float(steps.max()) * 25 - 20)
    assert "left_knee in 2 of 5 frames" in report.lines[0]


def test_rotation_that_the_hinges_cannot_do_is_reported() -> None:
    motion = qpos_to_motion(walking_qpos(4, 25), 25)
    assert motion_trajectory(motion)[1].lost == ()
    toes = ROBOT.skeleton.index("left_toe_base")
    motion.local_rotations[:, toes] = quaternion_to_matrix(torch.tensor([0.9, 0.1, 0.0, 0.0], dtype=torch.float64))
    (lost,) = motion_trajectory(motion, 50)[1].lost
    assert (lost.joint, lost.frames) == ("left_toe_base", 4)


@pytest.mark.parametrize("rate_hz", [0, -1, math.nan, math.inf, 1e9])
def test_invalid_rates_are_refused(rate_hz: float) -> None:
    with pytest.raises(RobotError, match="above 0"):
        controller_trajectory(random_qpos(3, 0), 25, rate_hz)


@pytest.mark.parametrize(("from_hz", "to_hz"), [(1e-320, 25.0), (1e-12, 10_000.0), (0.001, 501.0)])
def test_resampling_to_too_many_rows_is_refused(from_hz: float, to_hz: float) -> None:
    with pytest.raises(RobotError, match=r"5 rows at .* Hz are (\d+|inf) at .* Hz; 2000000 at most are made"):
        resample_qpos(walking_qpos(5, 25), from_hz, to_hz)


@pytest.mark.parametrize("rate_hz", [5e-324, 1e-320, 1e-9])
def test_a_tiny_rate_leaves_only_the_first_row(rate_hz: float) -> None:
    qpos = walking_qpos(5, 25)
    assert torch.equal(resample_qpos(qpos, 25, rate_hz), qpos[:1])


def test_qpos_of_integers_is_accepted() -> None:
    rows = torch.zeros(2, 36, dtype=torch.int64)
    rows[:, 3] = 1
    assert qpos_to_motion(rows, 25).num_frames == 2
