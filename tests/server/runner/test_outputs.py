"""Outputs on request, compared with the same numbers computed by the model library."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.representation import motion_from_pose
from motiongen_ardy.core.rotation import matrix_to_quaternion, quaternion_to_matrix
from motiongen_ardy.core.skeleton import forward_kinematics, load_skeleton
from motiongen_ardy.robot.g1 import load_g1, motion_to_qpos, qpos_to_local_rotations
from motiongen_ardy.robot.trajectory import clamp_to_range, velocities
from motiongen_server.runner.outputs import output_blocks, outputs_of_rows

FPS = 25


def turning(name: str, frames: int = 60) -> tuple[Motion, np.ndarray]:
    """A motion in which every joint turns steadily about its own axis, and its rows, with continuous signs."""
    skeleton, generator = load_skeleton(name), np.random.default_rng(5)
    axes = generator.normal(size=(skeleton.num_joints, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    time = np.arange(frames)[:, None] / FPS
    angle = (generator.uniform(-3, 3, skeleton.num_joints) + time * generator.uniform(-6, 6, skeleton.num_joints)) / 2
    turns = np.concatenate([np.cos(angle)[..., None], np.sin(angle)[..., None] * axes], axis=-1)
    root = np.array([3.0, 0.8, -2.0]) + time * [0.7, 0.0, 1.1]
    rows = np.concatenate([root, turns.reshape(frames, -1), np.zeros((frames, 4))], axis=1).astype(np.float32)
    rotations = quaternion_to_matrix(torch.from_numpy(rows[:, 3:-4].reshape(frames, -1, 4)).double())
    return motion_from_pose(skeleton, rotations, torch.from_numpy(rows[:, :3]).double(), FPS), rows


@pytest.mark.parametrize("name", ["core27", "g134"])
def test_joint_positions_rotations_and_velocities_equal_the_library_s(name: str) -> None:
    skeleton, (motion, rows) = load_skeleton(name), turning(name)
    asked = ["joint_velocities_mps", "joint_positions_m", "joint_global_rotation_quat_wxyz"]
    made = outputs_of_rows(skeleton, FPS, asked, rows)
    joints = skeleton.num_joints
    speeds, places, turns = np.split(made, [3 * joints, 6 * joints], axis=1)
    rotations, positions = forward_kinematics(skeleton, motion.local_rotations, motion.root_positions)
    np.testing.assert_allclose(places, positions[1:].flatten(1), atol=1e-5)
    np.testing.assert_allclose(speeds, (positions.diff(dim=0) * FPS).flatten(1), atol=1e-3)
    found = quaternion_to_matrix(torch.from_numpy(turns).double().reshape(-1, joints, 4))
    np.testing.assert_allclose(found, rotations[1:], atol=1e-5)


def test_signs_of_global_quaternions_are_continuous_across_chunks() -> None:
    skeleton, (_, rows) = load_skeleton("core27"), turning("core27")
    still = rows.copy()
    still[:, 3 + 4 * 5 : -4] = rows[0, 3 + 4 * 5 : -4]  # chains of a few turning joints, as in a body
    parts = [
        outputs_of_rows(skeleton, FPS, ["joint_global_rotation_quat_wxyz"], still[begin - 1 : begin + 7])
        for begin in range(1, 50, 7)
    ]
    turns = np.concatenate(parts).reshape(-1, 27, 4)
    assert (turns[1:] * turns[:-1]).sum(axis=-1).min() > 0.5


def test_qpos_is_clamped_to_the_robot_and_qvel_leads_from_row_to_row() -> None:
    skeleton, (motion, rows) = load_skeleton("g134"), turning("g134")
    qpos = outputs_of_rows(skeleton, FPS, ["g1_qpos"], rows)
    whole, _ = clamp_to_range(motion_to_qpos(motion))
    np.testing.assert_allclose(qpos[:, 7:], whole[1:, 7:], atol=1e-4)
    np.testing.assert_allclose(qpos[:, :3], whole[1:, :3], atol=1e-5)
    same = np.abs((qpos[:, 3:7] * whole[1:, 3:7].numpy()).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-6)
    assert (qpos[1:, 3:7] * qpos[:-1, 3:7]).sum(axis=1).min() > 0.9
    robot = load_g1()
    assert (qpos[:, 7:] >= robot.lower.numpy() - 1e-6).all()
    assert (qpos[:, 7:] <= robot.upper.numpy() + 1e-6).all()
    qvel = outputs_of_rows(skeleton, FPS, ["g1_qvel"], rows)
    forward = velocities(torch.from_numpy(qpos).double(), FPS)
    np.testing.assert_allclose(qvel[1:], forward[:-1], atol=2e-3)


def test_qpos_of_a_robot_pose_is_that_pose() -> None:
    robot = load_g1()
    qpos = torch.cat(
        [torch.tensor([1.0, 2.0, 0.8, math.cos(0.3), 0, 0, math.sin(0.3)]), (robot.lower + robot.upper) / 3]
    )
    local = matrix_to_quaternion(qpos_to_local_rotations(qpos[None])).flatten(1)
    row = torch.cat([torch.tensor([[2.0, 0.8, 1.0]]), local, torch.zeros(1, 4)], dim=1).float().repeat(2, 1)
    made = outputs_of_rows(robot.skeleton, FPS, ["g1_qpos"], row.numpy())[0]
    np.testing.assert_allclose(made[[0, 1, 2]], qpos[:3], atol=1e-6)
    np.testing.assert_allclose(made[7:], qpos[7:], atol=1e-5)


def test_only_the_robot_s_rig_offers_qpos_and_qvel() -> None:
    assert [block.name for block in output_blocks(load_skeleton("core27"))] == [
        "joint_positions_m",
        "joint_global_rotation_quat_wxyz",
        "joint_velocities_mps",
    ]
    widths = {block.name: block.width for block in output_blocks(load_skeleton("g134"))}
    assert (widths["g1_qpos"], widths["g1_qvel"]) == (36, 35)
