"""Constraint files: the client reads the same constraints from them as the model library."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from motiongen_ardy.core.constraint import limb_chains
from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.formats.constraints import (
    PoseConstraint,
    RootConstraint,
    constraint_targets,
    write_constraints,
)
from motiongen_client import InvalidInput, JointTargets, Keyframe, Rig, RootTrajectory, Waypoint
from motiongen_client.kinematics import quaternion_to_matrix
from motiongen_tools.constraint_file import read_constraints

SKELETONS = ("core27", "g134")


def rig_of(name: str) -> Rig:
    skeleton = load_skeleton(name)
    blocks = {"root_translation_m": 3, "joint_rotation_quat_wxyz": 4 * skeleton.num_joints, "foot_contact": 4}
    offsets = skeleton.offsets.astype(np.float32)
    limbs = dict(limb_chains(skeleton))
    return Rig(name, skeleton.joint_names, skeleton.parents, offsets, 20, blocks, skeleton.hip_joints, limbs)


def poses(name: str, *frames: int, limbs: tuple[str, ...] | None = None, moved: bool = False) -> PoseConstraint:
    numbers = torch.Generator().manual_seed(len(frames))
    joints = load_skeleton(name).num_joints
    vectors = torch.randn(len(frames), joints, 3, generator=numbers)
    ground = torch.randn(len(frames), 2, generator=numbers) if moved else None
    return PoseConstraint(frames, vectors, torch.randn(len(frames), 3, generator=numbers), limbs, ground)


@pytest.mark.parametrize("name", SKELETONS)
def test_full_poses_become_keyframes(name: str, tmp_path: Path) -> None:
    constraint = poses(name, 3, 9)
    write_constraints(tmp_path / "c.json", [constraint])
    targets = constraint_targets(load_skeleton(name), [constraint])
    found = read_constraints(tmp_path / "c.json", rig_of(name), 20)
    for keyframe, frame in zip(found, (3, 9), strict=True):
        assert isinstance(keyframe, Keyframe)
        expected = np.array([targets.positions[frame, joint] for joint in range(len(keyframe.positions_m))])
        np.testing.assert_allclose(keyframe.positions_m, expected, atol=1e-5)


def test_a_file_that_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motiongen_tools.constraint_file.MAX_BYTES", 1)
    (tmp_path / "c.json").write_text("[]")
    with pytest.raises(InvalidInput, match=r"at most 1 bytes$"):
        read_constraints(tmp_path / "c.json", rig_of("core27"), 20)


@pytest.mark.parametrize("limbs", [("LeftHand", "Hips"), ("LeftHand",)])
def test_limbs_keep_their_offset_from_a_moved_root(limbs: tuple[str, ...], tmp_path: Path) -> None:
    constraint = poses("core27", 2, limbs=limbs, moved=True)
    write_constraints(tmp_path / "c.json", [constraint])
    skeleton = load_skeleton("core27")
    mean, std = (torch.full((330,), number) for number in (0.0, 1.0))
    layout = Representation(skeleton, 20, Stats(mean, std))
    observed, _ = constraint_targets(skeleton, [constraint]).fill(layout, 2, 1)
    joints, _ = read_constraints(tmp_path / "c.json", rig_of("core27"), 3)
    assert isinstance(joints, JointTargets)
    seen = np.asarray(layout.positions_block(observed)[0])
    for joint, place in zip(joints.joints[1:], joints.positions_m[1:], strict=True):
        np.testing.assert_allclose(place, seen[joint], atol=1e-5)


@pytest.mark.parametrize("name", SKELETONS)
@pytest.mark.parametrize("limbs", [("LeftHand", "Hips"), ("RightFoot",), ("LeftFoot", "RightHand")])
def test_limbs_constrain_the_same_joints_as_in_the_model_library(
    name: str, limbs: tuple[str, ...], tmp_path: Path
) -> None:
    constraint = poses(name, 7, limbs=limbs)
    write_constraints(tmp_path / "c.json", [constraint])
    targets = constraint_targets(load_skeleton(name), [constraint])
    joints, facing = read_constraints(tmp_path / "c.json", rig_of(name), 8)
    assert isinstance(joints, JointTargets)
    assert isinstance(facing, Waypoint)
    assert set(joints.joints) == {0, *(joint for _, joint in targets.positions)}
    assert joints.rotations_quat_wxyz is not None
    for row, joint in enumerate(joints.joints):
        if joint:
            np.testing.assert_allclose(joints.positions_m[row], targets.positions[7, joint], atol=1e-5)
        quaternion = joints.rotations_quat_wxyz[row]
        if (7, joint) in targets.rotations:
            np.testing.assert_allclose(quaternion_to_matrix(quaternion), targets.rotations[7, joint], atol=1e-5)
        else:
            assert not quaternion.any()
    cosine, sine = targets.heading[7].tolist()
    assert facing.heading_rad == pytest.approx(np.arctan2(sine, cosine), abs=1e-4)
    np.testing.assert_allclose((facing.x_m, facing.z_m), targets.ground[7], atol=1e-5)


def test_a_pose_may_have_another_ground_position(tmp_path: Path) -> None:
    constraint = poses("core27", 2, moved=True)
    assert constraint.ground is not None
    write_constraints(tmp_path / "c.json", [constraint])
    (keyframe,) = read_constraints(tmp_path / "c.json", rig_of("core27"), 3)
    assert isinstance(keyframe, Keyframe)
    np.testing.assert_allclose(keyframe.positions_m[0, [0, 2]], constraint.ground[0], atol=1e-6)


def test_consecutive_frames_become_root_trajectories(tmp_path: Path) -> None:
    frames = (4, 5, 6, 9, 10, 2)
    ground, heading = torch.randn(6, 2), torch.randn(6)
    write_constraints(tmp_path / "c.json", [RootConstraint(frames, ground, heading)])
    found = read_constraints(tmp_path / "c.json", rig_of("core27"), 20, max_path_frames=2)
    assert all(isinstance(path, RootTrajectory) for path in found)
    spans = [(path.first_frame, len(path.positions_m)) for path in found if isinstance(path, RootTrajectory)]
    assert spans == [(4, 2), (6, 1), (9, 2), (2, 1)]
    joined = np.concatenate([path.positions_m for path in found if isinstance(path, RootTrajectory)])
    np.testing.assert_allclose(joined, ground, atol=1e-6)


def test_the_other_form_of_headings_and_positions_is_read(tmp_path: Path) -> None:
    entry = {
        "type": "root2d",
        "frame_indices": [3],
        "smooth_root_2d": [[1, 2]],
        "global_root_heading": [[0.0, 1.0]],
        "more": 1,
    }
    (tmp_path / "c.json").write_text(json.dumps([entry]))
    (path,) = read_constraints(tmp_path / "c.json", rig_of("core27"), 20)
    assert isinstance(path, RootTrajectory)
    assert path.headings_rad is not None
    assert path.headings_rad.tolist() == pytest.approx([np.pi / 2])


HANDS: dict[str, Any] = {"type": "end-effector", "frame_indices": [3], "root_positions": [[0, 1, 0]]}
HANDS["local_joints_rot"] = [[[0, 0, 0]] * load_skeleton("core27").num_joints]
ROOT: dict[str, Any] = {"type": "root2d", "frame_indices": [3], "root_2d": [[1, 2]]}


def test_a_file_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps([ROOT]), encoding="utf-8-sig")
    (path,) = read_constraints(tmp_path / "c.json", rig_of("core27"), 20)
    assert isinstance(path, RootTrajectory)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("{", "constraint file"),
        ('"no list"', "constraint file"),
        ("[1]", "constraint file"),
        (json.dumps([ROOT, {"type": "jump"}]), "constraint 1, type"),
        (json.dumps([{**ROOT, "frame_indices": [20]}]), "constraint 0, frame_indices"),
        (json.dumps([{**ROOT, "frame_indices": [True]}]), "constraint 0, frame_indices"),
        (json.dumps([{**ROOT, "root_2d": [[1, 2], [3, 4]]}]), "constraint 0, root_2d"),
        (json.dumps([{**ROOT, "root_2d": None}]), "constraint 0, root_2d"),
        (json.dumps([{**ROOT, "smooth_root_2d": [[1, 3]]}]), "constraint 0, smooth_root_2d"),
        (json.dumps([{**ROOT, "global_root_heading": [[3, 4]]}]), "constraint 0, global_root_heading"),
        (json.dumps([{"type": "fullbody", "frame_indices": [1]}]), "constraint 0, local_joints_rot"),
        ('[{"type": "root2d", "frame_indices": [1], "root_2d": [[NaN, 1]]}]', "constraint 0, root_2d"),
        (json.dumps([{**ROOT, "root_2d": [[1, 10**400]]}]), "constraint 0, root_2d"),
        (json.dumps([HANDS]), "constraint 0, joint_names"),
        (json.dumps([HANDS | {"joint_names": []}]), "constraint 0, joint_names"),
        (json.dumps([HANDS | {"joint_names": "LeftHand"}]), "constraint 0, joint_names"),
        (json.dumps([HANDS | {"joint_names": ["LeftHand", "Nose"]}]), "constraint 0, joint_names"),
        (json.dumps([HANDS | {"joint_names": [["LeftHand"]]}]), "constraint 0, joint_names"),
        (json.dumps([{**ROOT, "root_2d": [[1.5, True]]}]), "constraint 0, root_2d"),
        (json.dumps([ROOT]).replace('"frame_indices"', '"type": "root2d", "frame_indices"'), "constraint file"),
        (json.dumps([ROOT]).replace("[1, 2]", f"[1, {'9' * 5000}]"), "constraint file"),
    ],
)
def test_a_mistake_is_reported_with_entry_and_field(content: str, named: str, tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(content)
    with pytest.raises(InvalidInput) as refused:
        read_constraints(tmp_path / "c.json", rig_of("core27"), 20)
    assert refused.value.field == named


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="a file that can be read"):
        read_constraints(tmp_path / "none.json", rig_of("core27"), 20)
