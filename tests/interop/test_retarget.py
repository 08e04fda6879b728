"""Retargeting to a made-up body with other names, lengths, axes and rest pose, and back by the data tools."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from motiongen_ardy.core.rotation import quaternion_to_matrix as to_matrix
from motiongen_ardy.data.retarget import apply_retarget
from motiongen_ardy.data.retarget_file import read_retarget
from motiongen_client import InvalidInput, Motion, UnknownName
from motiongen_client.kinematics import forward_kinematics, matrix_to_quaternion
from motiongen_client.retarget import JointMap, Retargeter, UserSkeleton, read_joint_map
from tests.client.bodies import FPS, client_rig, swaying
from tests.conftest import ROOT

RIG = client_rig()

# their joint: parent, our joint, axes, offset from the parent in our neutral pose, cm (left, up, forward)
BODY: dict[str, tuple[str, str, str, tuple[float, float, float]]] = {
    "pelvis": ("", "Hips", "up right forward", (0, 0, 0)),
    "belly": ("pelvis", "Spine1", "up forward left", (0, 14, 0)),
    "chest": ("belly", "Spine3", "up forward left", (0, 31, 2)),
    "neck": ("chest", "Neck", "up forward left", (0, 20, 0)),
    "skull": ("neck", "Head", "up forward left", (0, 9, 3)),
    "arm_l": ("chest", "LeftArm", "left up forward", (21, 15, 0)),
    "elbow_l": ("arm_l", "LeftForeArm", "left up forward", (33, 0, 0)),
    "hand_l": ("elbow_l", "LeftHand", "left up forward", (29, 0, 0)),
    "arm_r": ("chest", "RightArm", "left down back", (-21, 15, 0)),
    "elbow_r": ("arm_r", "RightForeArm", "left down back", (-33, 0, 0)),
    "hand_r": ("elbow_r", "RightHand", "left down back", (-29, 0, 0)),
    "thigh_l": ("pelvis", "LeftUpLeg", "down left forward", (12, -9, 0)),
    "shin_l": ("thigh_l", "LeftLeg", "down left forward", (0, -55, 1)),
    "foot_l": ("shin_l", "LeftFoot", "forward left up", (0, -51, -2)),
    "toes_l": ("foot_l", "LeftToeBase", "forward left up", (0, -9, 19)),
    "thigh_r": ("pelvis", "RightUpLeg", "up left back", (-12, -9, 0)),
    "shin_r": ("thigh_r", "RightLeg", "up left back", (0, -55, 1)),
    "foot_r": ("shin_r", "RightFoot", "back left down", (0, -51, -2)),
    "toes_r": ("foot_r", "RightToeBase", "back left down", (0, -9, 19)),
}
EXTRA = {"ribs": "belly", "finger_l": "hand_l"}  # driven by nothing, or by `follow`
UNDRIVEN = ["LeftShoulder", "RightShoulder", "LeftHandEnd", "RightHandEnd", "LeftHandThumb1", "RightHandThumb1"]
MEASURED = {"lowest_of": ["LeftFoot", "RightFoot"], "percentile": 10, "height": 0.0737}
DOCUMENT: dict[str, Any] = {
    "name": "made_up",
    "skeleton": "core27",
    "metres_per_unit": 0.01,
    "values": {"pitch": 12.0},
    "groups": {"steep": {"pitch": 30.0}},
    "joints": {
        ours: {"from": theirs, "axes": axes.split()}
        | ({"turn": {"about": "left", "degrees": "pitch"}} if "toes" in theirs else {})
        for theirs, (_, ours, axes, _) in BODY.items()
    },
    "fill": {
        "Spine": {"between": ["Hips", "Spine1"], "fraction": 0.5},
        "Spine2": {"between": ["Spine1", "Spine3"], "fraction": 0.5},
        **dict.fromkeys(UNDRIVEN, "identity"),
    },
    "root": {
        "from": ["thigh_l", "thigh_r"],
        "to": ["LeftUpLeg", "RightUpLeg"],
        "scale": {
            "from": [["thigh_l", "shin_l", "foot_l"], ["thigh_r", "shin_r", "foot_r"]],
            "to": [["LeftUpLeg", "LeftLeg", "LeftFoot"], ["RightUpLeg", "RightLeg", "RightFoot"]],
        },
        "ground": {"source_height": 11.0, "height": 0.0737},
    },
}


def skeleton() -> UserSkeleton:
    """The made-up body, with bones in the axes of their parents; at rest its arms hang and its legs are apart."""
    drives = JointMap.of(DOCUMENT).drives
    names = [*BODY, *EXTRA]
    axes = {theirs: drives[theirs].axes for theirs in BODY} | {"ribs": np.eye(3), "finger_l": np.eye(3)}
    parent_of = {theirs: parent for theirs, (parent, *_) in BODY.items()} | EXTRA
    offsets, rest, world = [], [], {"": np.eye(3)}
    hang = {"arm_l": -0.9, "arm_r": 0.9, "thigh_l": 0.15, "thigh_r": -0.15}
    for name in names:
        bone = np.array(BODY[name][3] if name in BODY else (0.0, 4.0, 1.0))
        parent = parent_of[name]
        offsets.append(axes[parent].T @ bone if parent else np.array([0.0, 116.0, 0.0]))
        angle = hang.get(name, 0.0)
        sway = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        above = world[parent] @ (axes[parent].T if parent else np.eye(3))
        world[name] = above @ sway @ axes[name]
        rest.append(world[parent].T @ world[name])
    indices = {name: index for index, name in enumerate(names)}
    parents = [-1 if not parent_of[name] else indices[parent_of[name]] for name in names]
    return UserSkeleton(names, parents, np.array(offsets), matrix_to_quaternion(np.array(rest)))


def world_rotations(motion: Motion) -> np.ndarray:
    _, rotations = forward_kinematics(
        RIG.parents, RIG.offsets_m, motion.root_translation_m, motion.joint_rotation_quat_wxyz.astype(np.float64)
    )
    return rotations


def their_rotations(theirs: UserSkeleton, local: np.ndarray) -> np.ndarray:
    _, rotations = forward_kinematics(theirs.parents, theirs.offsets, np.zeros((len(local), 3)), local)
    return rotations


def test_motion_retargeted_and_back_by_the_data_tools_is_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "made_up.yaml"
    path.write_text(yaml.safe_dump(DOCUMENT))
    theirs, motion = skeleton(), swaying(RIG)
    carried = Retargeter(RIG, JointMap.of(DOCUMENT), theirs).apply(motion)
    clip = SimpleNamespace(
        joint_names=theirs.joint_names,
        offsets=theirs.offsets,
        fps=FPS,
        global_pose=lambda: (
            torch.from_numpy(their_rotations(theirs, carried.joint_rotation_quat_wxyz)),
            torch.from_numpy(carried.joint_positions()),
        ),
    )
    back = apply_retarget(read_retarget(path), clip, FPS)  # type: ignore[arg-type]
    ours = world_rotations(motion)
    local = to_matrix(back.local_rotations).numpy()
    found = np.empty_like(ours)
    for joint, parent in enumerate(RIG.parents):
        found[:, joint] = local[:, joint] if parent < 0 else found[:, parent] @ local[:, joint]
    driven = [RIG.index(name) for name in DOCUMENT["joints"]]
    np.testing.assert_allclose(found[:, driven], ours[:, driven], atol=1e-6)
    np.testing.assert_allclose(back.root_positions, motion.root_translation_m, atol=1e-5)


def test_limbs_point_in_the_same_directions() -> None:
    theirs, motion = skeleton(), swaying(RIG)
    joints = Retargeter(RIG, JointMap.of(DOCUMENT), theirs).apply(motion).joint_positions()
    arm = joints[:, theirs.index("hand_l")] - joints[:, theirs.index("elbow_l")]
    forearm = world_rotations(motion)[:, RIG.index("LeftForeArm")]
    np.testing.assert_allclose(arm, 29.0 * forearm[:, :, 0], atol=1e-6)


def test_standing_feet_are_as_high_as_at_rest_with_a_measured_ground() -> None:
    document = copy.deepcopy(DOCUMENT)
    document["root"]["ground"] = MEASURED
    theirs = skeleton()
    rows = np.zeros((1, RIG.row_width), np.float32)
    rows[:, 3:-4:4] = 1.0
    lowest = min(Motion(RIG, 0, rows).joint_positions_m()[0, [RIG.index("LeftFoot"), RIG.index("RightFoot")], 1])
    rows[:, 1] = MEASURED["height"] - lowest
    joints = Retargeter(RIG, JointMap.of(document), theirs).apply(Motion(RIG, 0, rows)).joint_positions()[0]
    rest = theirs.rest_positions()
    feet = [theirs.index("foot_l"), theirs.index("foot_r")]
    at_rest = rest[feet, 1].min() - rest[:, 1].min()
    assert joints[feet, 1].min() == pytest.approx(at_rest, abs=1e-5)


def test_undriven_joints_stay_at_rest_and_following_ones_lie_between() -> None:
    document = copy.deepcopy(DOCUMENT)
    document["follow"] = {"ribs": {"between": ["Spine1", "Spine3"], "fraction": 0.5}}
    theirs, motion = skeleton(), swaying(RIG)
    local = Retargeter(RIG, JointMap.of(document), theirs).apply(motion).joint_rotation_quat_wxyz
    finger = theirs.index("finger_l")
    np.testing.assert_allclose(np.abs((local[:, finger] * theirs.rest[finger]).sum(axis=1)), 1.0, atol=1e-9)
    ours = matrix_to_quaternion(world_rotations(motion))
    low, high = ours[:, RIG.index("Spine1")], ours[:, RIG.index("Spine3")]
    ribs = matrix_to_quaternion(their_rotations(theirs, local))[:, theirs.index("ribs")]
    towards = [np.abs((ribs * end).sum(axis=1)) for end in (low, high)]
    np.testing.assert_allclose(towards[0], towards[1], atol=1e-5)


def test_rotation_signs_continue_within_and_between_motions() -> None:
    retargeter, motion = Retargeter(RIG, JointMap.of(DOCUMENT), skeleton()), swaying(RIG, 60, most_rad=3.0)
    first = retargeter.apply(Motion(RIG, 0, motion.rows[:30]))
    second = retargeter.apply(Motion(RIG, 30, motion.rows[30:]), first.joint_rotation_quat_wxyz[-1])
    turns = np.concatenate([first.joint_rotation_quat_wxyz, second.joint_rotation_quat_wxyz])
    assert (turns[1:] * turns[:-1]).sum(axis=-1).min() >= 0


def test_rest_group_has_its_own_values_and_json_files_are_read(tmp_path: Path) -> None:
    path = tmp_path / "made_up.json"
    path.write_text(json.dumps(DOCUMENT))
    usual, steep = read_joint_map(path), read_joint_map(path, "steep")
    assert not np.allclose(usual.drives["toes_l"].axes, steep.drives["toes_l"].axes)
    assert np.allclose(usual.drives["hand_l"].axes, steep.drives["hand_l"].axes)


def test_retargets_of_the_data_tools_can_be_read() -> None:
    folder = ROOT / "ardy" / "motiongen_ardy" / "data" / "retargets"
    read = [JointMap.of(yaml.safe_load(path.read_text())) for path in folder.glob("*.yaml")]
    assert len(read) == 4
    assert all(("Hips", "Hips") in [drive.ours for drive in each.drives.values()] for each in read)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda document: document.update(extra=1), "joint map.extra"),
        (lambda document: document.pop("root"), "the key root as well"),
        (lambda document: document["joints"]["Hips"].update(axes=["up", "left", "forward"]), "right-handed"),
        (lambda document: document["joints"]["Hips"].update(axes=["up", "north", "left"]), "joints.Hips.axes"),
        (lambda document: document["root"].update(scale=0), "above 0"),
        (lambda document: document.update(follow={"hand_l": {"from": "LeftHand"}}), "follow.hand_l"),
        (lambda document: document.update(follow={"ribs": {"between": ["Hips", "Head"]}}), "between with fraction"),
        (lambda document: document["joints"]["LeftToeBase"]["turn"].update(degrees="slope"), "one of pitch"),
        (lambda document: document["joints"]["LeftToeBase"]["turn"].update(about=["left"]), "turn.about"),
        (lambda document: document["joints"]["Hips"].update(axes=5), "joints.Hips.axes"),
        (lambda document: document["joints"]["Hips"].update(axes=[["up"], "left", "back"]), "joints.Hips.axes"),
        (lambda document: document["joints"]["Hips"].update({"from": ["pelvis"]}), "joints.Hips.from"),
        (lambda document: document.update(joints=["Hips"]), "joints"),
        (lambda document: document.update(follow=None), "follow"),
        (lambda document: document.update(values=[1.0]), "values"),
        (lambda document: document.update(groups="steep"), "groups"),
        (lambda document: document.update(metres_per_unit=10**400), "metres_per_unit"),
        (lambda document: document["root"]["scale"].update({"from": 3}), "root.scale.from"),
        (lambda document: document["root"]["scale"].update(to=[["LeftUpLeg"]]), "root.scale.to.*two joints"),
    ],
)
def test_mistake_in_a_map_is_named_by_its_place(change: Any, says: str) -> None:
    document = copy.deepcopy(DOCUMENT)
    change(document)
    with pytest.raises(InvalidInput, match=says):
        JointMap.of(document)


def test_unknown_joints_are_named() -> None:
    theirs, ours = copy.deepcopy(DOCUMENT), copy.deepcopy(DOCUMENT)
    theirs["joints"]["Hips"]["from"] = "hip"
    with pytest.raises(UnknownName, match="'hip'"):
        Retargeter(RIG, JointMap.of(theirs), skeleton())
    ours["follow"] = {"ribs": {"from": "Tail"}}
    with pytest.raises(UnknownName, match="'Tail'"):
        Retargeter(RIG, JointMap.of(ours), skeleton())


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"parents": [0]}, "parents first"),
        ({"joint_names": []}, "one name or more"),
        ({"rest_quat_wxyz": np.zeros((1, 4))}, "unit quaternions"),
    ],
)
def test_invalid_skeleton_is_refused(fields: dict[str, Any], says: str) -> None:
    sound: dict[str, Any] = {"joint_names": ["a"], "parents": [-1], "offsets": np.zeros((1, 3))}
    with pytest.raises(InvalidInput, match=says):
        UserSkeleton(**{**sound, **fields})


def test_bones_without_length_give_no_scale() -> None:
    sound = skeleton()
    flat = UserSkeleton(sound.joint_names, sound.parents, np.zeros_like(sound.offsets), sound.rest_quat_wxyz)
    with pytest.raises(InvalidInput, match=r"root\.scale\.from: 'bones without length'"):
        Retargeter(RIG, JointMap.of(DOCUMENT), flat)


def test_ground_needs_feet_that_are_driven() -> None:
    document = copy.deepcopy(DOCUMENT)
    document["root"]["ground"] = {"lowest_of": ["LeftHandThumb1"], "height": 0.0}
    with pytest.raises(InvalidInput, match="lowest_of"):
        Retargeter(RIG, JointMap.of(document), skeleton())


@pytest.mark.parametrize("text", [b"{", b"\xff\xfe", b"[" * 100_000, b"9" * 5000, b"[]"])
def test_file_that_is_not_a_map_is_refused(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "map.json"
    path.write_bytes(text)
    with pytest.raises(InvalidInput):
        read_joint_map(path)
