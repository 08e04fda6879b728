"""Constraint lists: round trip, forms that are read, and entries and files that are refused."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.core.skeleton import load_skeleton, skeleton_names
from motiongen_ardy.formats.constraints import (
    LIMB_TYPES,
    PoseConstraint,
    RootConstraint,
    constraint_targets,
    parse_constraints,
    pose_constraint,
    read_constraints,
    write_constraints,
)
from motiongen_ardy.formats.errors import FormatError
from tests.ardy.formats.motions import random_motion

CORE = load_skeleton("core27")
GOLDEN = Path(__file__).resolve().parents[2] / "data" / "golden"
CASES: dict[str, Any] = json.loads((GOLDEN / "tiny-core27" / "vectors" / "conditions.json").read_text())["cases"]


def assert_same_targets(first: Any, second: Any) -> None:
    """Both lists of constraints give the same targets, bit for bit."""
    one, other = constraint_targets(CORE, first), constraint_targets(CORE, second)
    for group in ("ground", "height", "heading", "positions", "rotations"):
        mine, theirs = getattr(one, group), getattr(other, group)
        assert mine.keys() == theirs.keys()
        assert all(np.array_equal(mine[key], theirs[key]) for key in mine), group


@pytest.mark.parametrize("case", sorted(CASES))
def test_written_constraints_are_read_back_unchanged(tmp_path: Path, case: str) -> None:
    constraints = parse_constraints(CASES[case], CORE)
    write_constraints(tmp_path / "again.json", constraints)
    again = read_constraints(tmp_path / "again.json", CORE)
    assert_same_targets(constraints, again)
    kinds = [entry["type"] for entry in json.loads((tmp_path / "again.json").read_text())]
    assert kinds == [entry["type"] for entry in CASES[case]]


@settings(max_examples=30, deadline=None)
@given(
    frames=st.lists(st.integers(0, 2**31 - 2), max_size=4),
    place=st.floats(-1e6, 1e6),
    angle=st.none() | st.floats(-10, 10),
)
def test_any_root_constraint_round_trips(
    tmp_path_factory: Any, frames: list[int], place: float, angle: float | None
) -> None:
    path = tmp_path_factory.getbasetemp() / "root.json"
    ground = torch.full((len(frames), 2), place)
    heading = None if angle is None else torch.full((len(frames),), angle)
    write_constraints(path, [RootConstraint(tuple(frames), ground, heading)])
    (again,) = read_constraints(path, CORE)
    assert isinstance(again, RootConstraint)
    assert again.frames == tuple(frames)
    assert torch.equal(again.ground, ground)
    assert (again.heading is None) == (heading is None)
    assert heading is None or torch.equal(again.heading, heading)


@pytest.mark.parametrize("limbs", [None, *LIMB_TYPES.values(), ("LeftHand", "RightFoot", "Hips")])
@pytest.mark.parametrize("name", skeleton_names())
def test_pose_constraints_of_every_skeleton_round_trip(
    tmp_path: Path, name: str, limbs: tuple[str, ...] | None
) -> None:
    skeleton = load_skeleton(name)
    motion = random_motion(skeleton, 6, seed=1).motion
    write_constraints(tmp_path / "poses.json", [pose_constraint(motion, [1, 4], limbs)])
    (again,) = read_constraints(tmp_path / "poses.json", skeleton, num_frames=5)
    assert isinstance(again, PoseConstraint)
    assert (again.frames, set(again.limbs or ())) == ((1, 4), set(limbs or ()))
    targets = constraint_targets(skeleton, [again])
    positions = motion.positions(skeleton)
    for (frame, joint), position in targets.positions.items():
        torch.testing.assert_close(torch.from_numpy(position), positions[frame, joint], atol=1e-4, rtol=0)


def test_headings_may_be_angles_or_pairs_of_cosine_and_sine() -> None:
    """ARDY writes angles, Kimodo the cosine and the sine; the shape decides."""
    angles = [0.3, -2.0, math.pi / 2]
    entry = {"type": "root2d", "frame_indices": [0, 1, 2], "root_2d": [[0, 0]] * 3}
    (by_angle,) = parse_constraints([{**entry, "global_root_heading": angles}], CORE)
    pairs = [[math.cos(angle), math.sin(angle)] for angle in angles]
    (by_pair,) = parse_constraints([{**entry, "global_root_heading": pairs}], CORE)
    assert isinstance(by_pair, RootConstraint)
    assert isinstance(by_angle, RootConstraint)
    assert by_pair.heading is not None
    torch.testing.assert_close(by_pair.heading, by_angle.heading)


@pytest.mark.parametrize("name", ["root_2d", "smooth_root_2d"])
def test_both_names_of_the_ground_position_are_read(name: str) -> None:
    entry = {"type": "root2d", "frame_indices": [4], name: [[1.0, 2.0]], "somebody_elses": {"colour": 3}}
    assert constraint_targets(CORE, parse_constraints([entry], CORE)).ground[4].tolist() == [1, 2]
    moved = {**CASES["fullbody"][0], name: [[7.0, 8.0]] * len(CASES["fullbody"][0]["frame_indices"])}
    moved.pop("smooth_root_2d" if name == "root_2d" else "root_2d", None)
    targets = constraint_targets(CORE, parse_constraints([moved], CORE))
    assert {tuple(ground.tolist()) for ground in targets.ground.values()} == {(7.0, 8.0)}


def change(**fields: object) -> Any:
    def apply(entry: dict[str, object]) -> None:
        entry.update(fields)

    return apply


@pytest.mark.parametrize(
    ("case", "edit", "message"),
    [
        ("root2d", change(type="jump"), "constraint 0: type is 'jump'; it must be one of root2d"),
        ("root2d", change(type=["root2d"]), "type is list"),
        ("root2d", change(frame_indices=[2, 7.5, 9]), "holds 7.5; give whole numbers of 0"),
        ("root2d", change(frame_indices=[2, -7, 9]), "holds -7; give whole numbers of 0"),
        ("root2d", change(frame_indices=[2, True, 9]), "holds True"),
        ("root2d", change(frame_indices=[2, 10**30, 9]), "holds 10000"),
        ("root2d", change(frame_indices=3), "frame_indices is 3"),
        ("root2d", change(root_2d=[[1, 2]]), r"root_2d is not an array .* a list of 1; its shape must be \(3, 2\)"),
        ("root2d", change(root_2d="here"), "not an array of numbers: 'here'"),
        ("root2d", change(root_2d=[[1, 2], [3], [4, 5]]), r"at \[1\]: a list of 1"),
        ("root2d", change(root_2d=[[1, 2], [3, "4"], [4, 5]]), r"not an array of numbers: '4' at \[1, 1\]"),
        ("root2d", change(root_2d=[[1, 2], [3, 1e300], [4, 5]]), "beyond 3.4e38"),
        ("root2d", change(smooth_root_2d=[[1, 2]] * 3), "differ; they are two names"),
        ("root2d", lambda entry: entry.pop("root_2d"), "root_2d is missing; the entry has 'type'"),
        ("root2d", lambda entry: entry.pop("frame_indices"), "frame_indices is missing"),
        ("root2d_heading", change(global_root_heading=[0.0, float("nan")]), "NaN or infinite"),
        ("root2d_heading", change(global_root_heading=[[1.0, 0.0], [2.0, 0.0]]), "give angles in radians, or pairs"),
        ("fullbody", lambda entry: entry.pop("root_positions"), "root_positions is missing"),
        ("fullbody", change(local_joints_rot=[]), "local_joints_rot is not an array"),
        ("end_effector", change(joint_names="LeftHand"), "joint_names is 'LeftHand'; give a list"),
        ("end_effector", change(joint_names=[]), "joint_names is list; give a list of one or more"),
        ("end_effector", change(joint_names=["Nose"]), "holds 'Nose'; give a list of one or more of LeftHand"),
        ("end_effector", change(joint_names=[["Nose"]]), "holds list"),
    ],
)
def test_invalid_entries_are_refused(case: str, edit: Any, message: str) -> None:
    entries = copy.deepcopy(CASES[case])
    edit(entries[0])
    with pytest.raises(FormatError, match=message):
        parse_constraints(entries, CORE)


@pytest.mark.parametrize("content", [None, {}, "list", [3], [None]])
def test_json_that_is_not_a_list_of_objects_is_refused(content: object) -> None:
    with pytest.raises(FormatError, match="give a"):
        parse_constraints(content, CORE)


def test_frames_beyond_the_clip_are_refused() -> None:
    entry = {"type": "root2d", "frame_indices": [4, 60], "root_2d": [[1.0, 2.0]] * 2}
    assert len(parse_constraints([entry], CORE, num_frames=61)) == 1
    with pytest.raises(FormatError, match="holds 60; give whole numbers of 0 to 59"):
        parse_constraints([entry], CORE, num_frames=60)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[", "not JSON"),
        (b"\xff\xfe[]", "not UTF-8"),
        (b"[" * 100_000, "nested too deeply"),
        (b'[{"type": "root2d", "type": "fullbody"}]', "'type' twice"),
        # a search through all names for each name would take minutes
        (b"[{" + b",".join(b'"%d": 0' % (number % 200_000) for number in range(200_001)) + b"}]", "'0' twice"),
        (b'[{"type": "root2d", "frame_indices": [0], "root_2d": [[NaN, 0]]}]', "the number NaN"),
        (b'[{"type": "root2d", "frame_indices": [0], "root_2d": [[1e999, 0]]}]', "NaN or infinite"),
        (b"[" + b"9" * 5000 + b"]", "not JSON"),
        (b"", "not JSON"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message):
        read_constraints(path, CORE)


def test_numbers_that_are_not_finite_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_constraints(tmp_path / "bad.json", [RootConstraint((0,), torch.tensor([[math.nan, 0.0]]))])
    assert not (tmp_path / "bad.json").exists()
