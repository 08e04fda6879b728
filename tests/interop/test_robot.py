"""People's motion on the G1 robot: angles within their ranges, limb directions, and the safe hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from motiongen_ardy.robot.g1 import load_g1, qpos_to_motion
from motiongen_client import InvalidInput, Motion
from motiongen_client.robot import HINGES, G1Retargeter, HoldState, SafeHold
from motiongen_client.robot.chains import Chain
from motiongen_client.robot.g1 import LOWER, SPEED_LIMITS, UPPER
from tests.client.bodies import FPS, client_rig, swaying, walking

RIG = client_rig()


def still(**turns: tuple[float, float, float]) -> Motion:
    """A person in the neutral pose, with some joints turned by rotation vectors (radians about x, y and z)."""
    rows = np.zeros((4, RIG.row_width), np.float32)
    rows[:, 3:-4:4] = 1.0
    rows[:, 1] = 0.9696
    for name, about in turns.items():
        angle = float(np.linalg.norm(about))
        start = 3 + 4 * RIG.index(name)
        rows[:, start] = np.cos(angle / 2)
        rows[:, start + 1 : start + 4] = np.sin(angle / 2) * np.array(about) / angle
    return Motion(RIG, 0, rows)


def arms_down() -> dict[str, tuple[float, float, float]]:
    return {"LeftArm": (0, 0, -1.4), "RightArm": (0, 0, 1.4)}


def test_hinges_equal_those_of_the_model_library() -> None:
    robot = load_g1()
    assert tuple(hinge.name for hinge in HINGES) == robot.hinges
    np.testing.assert_allclose([hinge.axis for hinge in HINGES], robot.axes)
    np.testing.assert_allclose(LOWER, robot.lower)
    np.testing.assert_allclose(UPPER, robot.upper)
    np.testing.assert_allclose(SPEED_LIMITS, robot.speed_limits)
    moved = [body for body in robot.bodies if body.hinge is not None]
    np.testing.assert_allclose([hinge.quaternion_wxyz for hinge in HINGES], [body.quaternion for body in moved])


@pytest.mark.parametrize(
    "hinges",
    [
        "left_hip_pitch left_hip_roll left_hip_yaw",
        "waist_yaw waist_roll waist_pitch",
        "left_shoulder_pitch left_shoulder_roll left_shoulder_yaw",
        "right_knee",
    ],
)
def test_reachable_rotation_is_solved_exactly(hinges: str) -> None:
    chain, generator = Chain(hinges.split()), np.random.default_rng(2)
    middle = (LOWER[chain.indices] + UPPER[chain.indices]) / 2
    angles = middle + generator.uniform(-0.4, 0.4, (50, len(chain.indices)))
    found, lost = chain.angles(chain.rotation(angles), np.tile(middle, (50, 1)))
    assert lost.max() < 0.01
    np.testing.assert_allclose(chain.rotation(found), chain.rotation(angles), atol=0.01)


def test_person_with_arms_down_becomes_the_robot_at_angles_0_with_forearms_down() -> None:
    state = G1Retargeter(RIG).apply(still(LeftArm=(0, 0, -np.pi / 2), RightArm=(0, 0, np.pi / 2)))
    by_name = dict(zip([hinge.name for hinge in HINGES], state.qpos[0, 7:], strict=True))
    elbows = {name: angle for name, angle in by_name.items() if "elbow" in name}
    assert all(angle == pytest.approx(np.pi / 2, abs=0.02) for angle in elbows.values()), (
        "forearms straight down, not forward"
    )
    others = {name: angle for name, angle in by_name.items() if "elbow" not in name}
    assert max(abs(angle) for angle in others.values()) < 0.02, others
    assert state.qpos[0, 2] == pytest.approx(0.793, abs=0.005)


def pose(state: np.ndarray) -> dict[str, np.ndarray]:
    skeleton = load_g1().skeleton
    joints = qpos_to_motion(torch.from_numpy(state), FPS).positions(skeleton).numpy()
    return dict(zip(skeleton.joint_names, np.moveaxis(joints, 1, 0), strict=True))


@pytest.mark.parametrize(
    "turns",
    [
        arms_down(),
        {"LeftArm": (0.0, 0.0, -0.6), "LeftForeArm": (0.0, -0.9, 0.0), "RightArm": (0, 0, 1.2)},
        {**arms_down(), "LeftUpLeg": (-0.7, 0.0, 0.1), "LeftLeg": (0.9, 0.0, 0.0)},
    ],
)
def test_robots_limbs_point_where_the_persons_do(turns: dict[str, tuple[float, float, float]]) -> None:
    person = still(**turns)
    state = G1Retargeter(RIG).apply(person)
    robot, ours = pose(state.qpos), person.joint_positions_m()
    pairs = [
        ("left_shoulder_roll_skel", "left_elbow_skel", "LeftArm", "LeftForeArm"),
        ("right_shoulder_roll_skel", "right_elbow_skel", "RightArm", "RightForeArm"),
        ("left_knee_skel", "left_ankle_pitch_skel", "LeftLeg", "LeftFoot"),
        ("right_knee_skel", "right_ankle_pitch_skel", "RightLeg", "RightFoot"),
    ]
    for start, end, ours_start, ours_end in pairs:
        limb = robot[end][0] - robot[start][0]
        wanted = ours[0, RIG.index(ours_end)] - ours[0, RIG.index(ours_start)]
        cosine = limb @ wanted / np.linalg.norm(limb) / np.linalg.norm(wanted)
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 25, (
            start,
            limb,
            wanted,
        )  # the robot's bones are bent by up to 15


def test_ranges_and_speed_limits_are_kept_with_any_motion() -> None:
    state = G1Retargeter(RIG).apply(swaying(RIG, 80, most_rad=2.5))
    angles = state.qpos[:, 7:]
    assert (angles >= LOWER - 1e-9).all()
    assert (angles <= UPPER + 1e-9).all()
    assert (np.abs(np.diff(angles, axis=0)) <= SPEED_LIMITS / FPS + 1e-9).all()
    assert state.lost_rad.max() > 0.1, "the robot cannot follow all of that motion"


def test_states_continue_between_parts_and_agree_with_their_velocities() -> None:
    retargeter, walk = G1Retargeter(RIG), walking(RIG)
    first = retargeter.apply(Motion(RIG, 0, walk.rows[:40]))
    second = retargeter.apply(Motion(RIG, 40, walk.rows[40:]), first.qpos[-1])
    qpos, qvel = np.concatenate([first.qpos, second.qpos]), np.concatenate([first.qvel, second.qvel])
    np.testing.assert_allclose(np.diff(qpos[:, 7:], axis=0) * FPS, qvel[1:, 6:], atol=1e-9)
    np.testing.assert_allclose(np.diff(qpos[:, :3], axis=0) * FPS, qvel[1:, :3], atol=1e-9)
    assert (qpos[1:, 3:7] * qpos[:-1, 3:7]).sum(axis=1).min() > 0.9
    ahead = qpos[-1, 0] - qpos[0, 0]
    assert ahead == pytest.approx(retargeter.scale * (walk.rows[-1, 2] - walk.rows[0, 2]), rel=1e-3)


def test_smooth_motion_gives_no_jumps_in_angles() -> None:
    state = G1Retargeter(RIG).apply(swaying(RIG, 80, most_rad=0.3))
    assert np.abs(np.diff(state.qpos[:, 7:], n=2, axis=0)).max() < 0.1


def test_another_rig_is_refused() -> None:
    with pytest.raises(InvalidInput, match="LeftUpLeg"):
        G1Retargeter(client_rig("g134"))


# ---- when frames stop

RATE = 200
WALK = G1Retargeter(RIG).apply(walking(RIG)).qpos


def played(hold: SafeHold, gap: range, seconds: float = 4.0) -> tuple[np.ndarray, list[HoldState]]:
    """Commands at RATE while frames come at FPS, except during a gap."""
    commands, states = [], []
    for tick in range(int(seconds * RATE)):
        frame, is_due = divmod(tick, RATE // FPS)
        new = WALK[frame] if is_due == 0 and frame not in gap else None
        commands.append(hold.command(tick / RATE, new))
        states.append(hold.state)
    return np.array(commands), states


def test_robot_without_frames_comes_to_a_stop_and_returns_softly() -> None:
    commands, states = played(SafeHold(), range(20, 50))
    order = [state for state, before in zip(states, [None, *states], strict=False) if state is not before]
    assert order == [
        HoldState.FOLLOWING,
        HoldState.STOPPING,
        HoldState.HOLDING,
        HoldState.RETURNING,
        HoldState.FOLLOWING,
    ]
    holding = [tick for tick, state in enumerate(states) if state is HoldState.HOLDING]
    assert np.ptp(commands[holding], axis=0).max() < 1e-9
    assert holding[0] / RATE == pytest.approx(19 / FPS + 0.15 + 0.3, abs=0.03)
    angles = commands[:, 7:]
    assert (angles >= LOWER - 1e-9).all()
    assert (angles <= UPPER + 1e-9).all()
    assert (np.abs(np.diff(angles, axis=0)) <= SPEED_LIMITS / RATE + 1e-9).all()
    np.testing.assert_allclose(np.linalg.norm(commands[:, 3:7], axis=1), 1.0)
    stopping = [tick for tick, state in enumerate(states) if state is HoldState.STOPPING]
    pace = np.abs(np.diff(commands[stopping[0] : holding[0], :3], axis=0)).sum(axis=1)
    assert pace[-1] < 0.1 * pace[0], "it must slow down gradually"
    np.testing.assert_allclose(commands[-1], WALK[79] * np.sign(commands[-1, 3] * WALK[79, 3]) ** np.isin(
        np.arange(36), range(3, 7)), atol=1e-6)  # fmt: skip


def test_frames_in_time_are_passed_on_unchanged() -> None:
    commands, states = played(SafeHold(), range(0))
    assert set(states) == {HoldState.FOLLOWING}
    np.testing.assert_allclose(commands[9::10, 7:], WALK[:80, 7:], atol=1e-9)


def yawed(radians: float, sign: float = 1.0) -> np.ndarray:
    """The robot upright at angles 0, turned about the vertical."""
    qpos = np.zeros(36)
    qpos[2], qpos[3], qpos[6] = 0.793, sign * np.cos(radians / 2), sign * np.sin(radians / 2)
    return qpos


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_root_turns_the_short_way_back_for_either_quaternion_sign(sign: float) -> None:
    hold, held, back = SafeHold(), np.radians(17.2), np.radians(20.05)
    for now_s in (0.0, 1.0, 2.0):
        hold.command(now_s, yawed(held) if now_s == 0 else None)
    assert hold.state is HoldState.HOLDING
    commands = np.array([hold.command(3.0 + tick / 20, yawed(back, sign)) for tick in range(20)])
    yaw = np.arctan2(2 * commands[:, 3] * commands[:, 6], 1 - 2 * commands[:, 6] ** 2)
    assert (np.diff(yaw) >= -1e-9).all()
    assert (yaw[0], yaw[-1]) == pytest.approx((held, back))
    assert (commands[1:, 3:7] * commands[:-1, 3:7]).sum(axis=1).min() > 0.9, "the commands keep one sign"


def test_array_of_a_frame_may_be_reused() -> None:
    hold, buffer = SafeHold(), yawed(0.3)
    hold.command(0.0, buffer)
    buffer[:] = yawed(2.0)
    np.testing.assert_allclose(hold.command(0.01), yawed(0.3))


@pytest.mark.parametrize("now_s", [1.0, 0.5])
def test_no_joint_moves_while_the_clock_stands_still_or_goes_back(now_s: float) -> None:
    hold, there = SafeHold(), yawed(0.3)
    first = hold.command(1.0, there)
    there[7:] = UPPER
    np.testing.assert_allclose(hold.command(now_s, there), first)
    moved = np.abs(hold.command(1.01)[7:] - first[7:])
    assert (moved > 0).any()
    assert (moved <= SPEED_LIMITS * 0.01 + 1e-9).all()


def test_invalid_states_and_settings_are_refused() -> None:
    with pytest.raises(InvalidInput, match="a unit quaternion"):
        SafeHold().command(0.0, np.zeros(36))
    with pytest.raises(InvalidInput, match="a first state"):
        SafeHold().command(0.0)
    with pytest.raises(InvalidInput, match="36 finite numbers"):
        SafeHold().command(0.0, np.zeros(35))
    bad: dict[str, Any] = {"stop_s": 0.0}
    with pytest.raises(InvalidInput, match="seconds above 0"):
        SafeHold(**bad)
