"""Motion of the skeleton g134 <-> qpos, against this library's kinematics and against MuJoCo's."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.formats.g1_csv import qpos_motion, write_controller_csv, write_qpos_csv
from motiongen_ardy.robot.g1 import (
    TO_ROBOT,
    RobotError,
    load_g1,
    lost_rotation,
    motion_to_qpos,
    qpos_to_motion,
)
from motiongen_ardy.robot.mjcf import g1_mjcf
from motiongen_ardy.robot.trajectory import controller_trajectory
from tests.ardy.robot.poses import random_qpos

ROBOT = load_g1()


def same_sign(qpos: Tensor, like: Tensor) -> Tensor:
    """The same rows with the quaternion's sign of other rows: q and -q are one rotation."""
    sign = torch.where((qpos[:, 3:7] * like[:, 3:7]).sum(1, keepdim=True) < 0, -1.0, 1.0)
    return torch.cat([qpos[:, :3], sign * qpos[:, 3:7], qpos[:, 7:]], dim=1)


@pytest.fixture(scope="module")
def simulator() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(g1_mjcf())
    return model, mujoco.MjData(model)


def link_positions(simulator: tuple[mujoco.MjModel, mujoco.MjData], row: Tensor) -> dict[str, Tensor]:
    """Where MuJoCo puts every body, in its frame."""
    model, data = simulator
    data.qpos[:] = row.numpy()
    mujoco.mj_kinematics(model, data)
    return {body.name: torch.from_numpy(data.body(body.name).xpos.copy()) for body in ROBOT.bodies}


def joint_of(body: str, hinge: str | None) -> int:
    return 0 if hinge is None else ROBOT.skeleton.index(f"{hinge}_skel")


def test_tables_of_the_robot_agree_with_the_skeleton() -> None:
    assert len(ROBOT.hinges) == 29
    assert ROBOT.hinges[:4] == ("left_hip_pitch", "left_hip_roll", "left_hip_yaw", "left_knee")
    assert ROBOT.hinges[12:15] == ("waist_yaw", "waist_roll", "waist_pitch")
    assert ROBOT.hinges[-1] == "right_wrist_yaw"
    for body in ROBOT.bodies[1:]:
        offset = TO_ROBOT @ torch.tensor(ROBOT.skeleton.offsets[joint_of(body.name, body.hinge)])
        torch.testing.assert_close(offset, torch.tensor(body.position, dtype=torch.float64), atol=1e-9, rtol=0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_qpos_round_trips_through_motion(seed: int) -> None:
    qpos = random_qpos(3, seed)
    again = motion_to_qpos(qpos_to_motion(qpos, 25))
    torch.testing.assert_close(same_sign(again, qpos), qpos, atol=1e-9, rtol=0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_positions_round_trip_through_float32_motion(seed: int) -> None:
    """Models generate float32: its forward kinematics and those of its qpos agree to 1e-5 m."""
    exact = qpos_to_motion(random_qpos(3, seed), 25)
    motion = Motion(exact.local_rotations.float(), exact.root_positions.float(), exact.foot_contacts, 25)
    again = qpos_to_motion(motion_to_qpos(motion), 25)
    error = (again.positions(ROBOT.skeleton) - motion.positions(ROBOT.skeleton)).abs().max()
    assert error < 1e-5


def test_rotation_that_no_hinge_can_do_is_measured() -> None:
    motion = qpos_to_motion(random_qpos(2, 0), 25)
    knee = ROBOT.skeleton.index("left_knee_skel")
    sideways = torch.tensor([math.cos(0.1), 0.0, math.sin(0.1), 0.0], dtype=torch.float64)
    bent = motion.local_rotations.clone()
    bent[1, knee] = bent[1, knee] @ quaternion_to_matrix(sideways)  # 0.2 rad about our up axis: no knee does that
    bent = Motion(bent, motion.root_positions, motion.foot_contacts, 25)
    lost = lost_rotation(bent, motion_to_qpos(bent))
    assert lost[1, knee] == pytest.approx(0.2, abs=0.02)
    lost[1, knee] = 0
    assert lost.max() < 1e-6


def test_axes_are_converted_to_those_of_the_robot() -> None:
    """At heading 0 our +Z is the robot's +X; a quarter turn to our +X (left) is one about its up axis."""
    rotations = torch.eye(3, dtype=torch.float64).repeat(1, 34, 1, 1)
    rotations[0, 0] = quaternion_to_matrix(
        torch.tensor([math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0], dtype=torch.float64)
    )
    motion = Motion(rotations, torch.tensor([[1.0, 0.8, 3.0]]), torch.zeros(1, 4, dtype=torch.bool), 25)
    row = motion_to_qpos(motion)[0]
    assert row[:3].tolist() == pytest.approx([3.0, 1.0, 0.8])
    assert row[3:7].tolist() == pytest.approx([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])


def test_motion_of_another_skeleton_is_refused() -> None:
    core = load_skeleton("core27")
    rotations = torch.eye(3).repeat(2, core.num_joints, 1, 1)
    motion = Motion(rotations, torch.zeros(2, 3), torch.zeros(2, 4, dtype=torch.bool), 20)
    with pytest.raises(RobotError, match="27 joints"):
        motion_to_qpos(motion)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda qpos: qpos[:, :35], r"shape \(4, 35\); give \(frames, 36\)"),
        (lambda qpos: qpos[:0], "one frame or more"),
        (lambda qpos: qpos[0], "give"),
        (lambda qpos: qpos * torch.where(torch.arange(4)[:, None] == 2, math.nan, 1.0), "row 2 .* NaN"),
        (lambda qpos: torch.cat([qpos[:, :3], qpos[:, 3:7] * 0, qpos[:, 7:]], 1), "length 0"),
        (lambda qpos: torch.cat([qpos[:, :3], qpos[:, 3:7] * 2, qpos[:, 7:]], 1), "unit quaternion w, x, y, z"),
    ],
)
def test_invalid_qpos_is_refused(change: object, message: str) -> None:
    assert callable(change)
    with pytest.raises(RobotError, match=message):
        qpos_to_motion(change(random_qpos(4, 0)), 25)


@pytest.mark.parametrize("seed", range(5))
def test_mujoco_link_positions_equal_those_of_our_kinematics(simulator: object, seed: int) -> None:
    qpos = random_qpos(4, seed)
    expected = qpos_to_motion(qpos, 25).positions(ROBOT.skeleton) @ TO_ROBOT.T
    for frame, row in enumerate(motion_to_qpos(qpos_to_motion(qpos, 25))):
        found = link_positions(simulator, row)  # type: ignore[arg-type]
        for body in ROBOT.bodies:
            error = (found[body.name] - expected[frame, joint_of(body.name, body.hinge)]).abs().max()
            assert error < 1e-6, f"{body.name} is {1000 * error:.3f} mm off in frame {frame}"


def test_mujoco_link_positions_of_exported_files_equal_those_of_the_motion(simulator: object, tmp_path: Path) -> None:
    """Through both file formats and float32, as a robot's user loads them."""
    stored = qpos_motion("random", random_qpos(4, 9), 25)
    expected = stored.positions().double() @ TO_ROBOT.T
    write_qpos_csv(tmp_path / "motion.csv", stored)
    write_controller_csv(tmp_path / "motion.controller.csv", stored)
    plain = np.loadtxt(tmp_path / "motion.csv", delimiter=",")
    controller = np.loadtxt(tmp_path / "motion.controller.csv", delimiter=",", skiprows=1)[:, 1:37]
    for rows in (plain, controller):
        for frame, row in enumerate(torch.from_numpy(rows)):
            found = link_positions(simulator, row)  # type: ignore[arg-type]
            for body in ROBOT.bodies:
                error = (found[body.name] - expected[frame, joint_of(body.name, body.hinge)]).abs().max()
                assert error < 1e-5, f"{body.name} is {1000 * error:.3f} mm off in frame {frame}"


def test_mujoco_integrates_our_velocities_from_row_to_row(simulator: object) -> None:
    model, _ = simulator  # type: ignore[misc]
    trajectory, _ = controller_trajectory(random_qpos(6, 3), 25, 60)
    for row, velocity, after in zip(trajectory.qpos, trajectory.qvel, trajectory.qpos[1:], strict=False):
        reached = row.numpy().copy()
        mujoco.mj_integratePos(model, reached, velocity.numpy(), 1 / 60)
        torch.testing.assert_close(torch.from_numpy(reached), after, atol=1e-9, rtol=0)


def test_the_generated_mujoco_model_has_the_robots_joint_ranges(simulator: object) -> None:
    model, _ = simulator  # type: ignore[misc]
    assert (model.nq, model.nv) == (36, 35)
    for hinge, lower, upper in zip(ROBOT.hinges, ROBOT.lower.tolist(), ROBOT.upper.tolist(), strict=True):
        assert model.joint(f"{hinge}_joint").range.tolist() == pytest.approx([lower, upper])
