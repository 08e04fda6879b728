"""Targets of a take in the JSON that motion tools exchange: written, and read back as the same constraints."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motiongen_client import InvalidInput, Motion
from motiongen_client.types import JointTargets, Keyframe, Placement, RootTrajectory, Waypoint
from motiongen_tools.constraint_file import read_constraints
from motiongen_tools.view.constraint_list import moved, read_list, write_constraint_list
from motiongen_tools.view.script import Target


def target(key: int, is_removed: bool = False, placement: Placement | None = None, **spec: Any) -> Target:
    return Target(key, spec, None, is_removed, None, placement)


@pytest.fixture
def take(stick_motion: Motion) -> Motion:
    """Frames 100 to 139, of a rig whose limbs and hips are known."""
    rig = dataclasses.replace(stick_motion.rig, hip_joints=(1, 2), limbs={"RightHand": (6,), "Hips": (0,)})
    return Motion(rig, 100, stick_motion.rows)


def again(text: str, take: Motion, tmp_path: Path) -> list[Any]:
    (tmp_path / "list.json").write_text(text)
    return read_constraints(tmp_path / "list.json", take.rig, len(take))


def test_root_and_heading_constraints_are_written(take: Motion, tmp_path: Path) -> None:
    text, told = write_constraint_list(
        [
            target(1, kind="waypoint", frame=110, x_m=1.0, z_m=2.0, heading_rad=0.5),
            target(2, kind="waypoint", frame=500, x_m=1.0, z_m=2.0),
            target(3, kind="waypoint", frame=120, x_m=9.0, z_m=9.0, is_removed=True),
            target(4, kind="trajectory", first_frame=138, positions_m=[[0, 1], [0, 2], [0, 3]]),
            target(5, kind="heading", frame=120, heading_rad=1.0),
        ],
        take,
    )
    waypoint, path, heading = json.loads(text)
    assert waypoint == {
        "type": "root2d",
        "frame_indices": [10],
        "root_2d": [[1.0, 2.0]],
        "global_root_heading": [0.5],
    }
    assert (path["frame_indices"], path["root_2d"]) == ([38, 39], [[0, 1], [0, 2]])
    assert (heading["frame_indices"], heading["global_root_heading"]) == ([20], [1.0])
    np.testing.assert_allclose(heading["root_2d"][0], take.root_translation_m[20][[0, 2]])
    assert told == [
        "constraint 2, waypoint: its frame 500 is not in the take",
        "constraint 5, heading: written with the place that it has in the take",
    ]
    assert len(again(text, take, tmp_path)) == 3


def test_a_keyframe_round_trips(take: Motion, tmp_path: Path) -> None:
    places = take.joint_positions_m()[30] + np.array([0.3, 0.0, 0.2], np.float32)
    text, told = write_constraint_list([target(1, kind="keyframe", frame=110, positions_m=places.tolist())], take)
    (found,) = again(text, take, tmp_path)
    assert isinstance(found, Keyframe)
    assert found.frame == 10
    np.testing.assert_allclose(found.positions_m, places, atol=1e-4)
    assert told == []


def test_a_joint_target_is_written_at_its_position(take: Motion, tmp_path: Path) -> None:
    hand = 6
    place = take.joint_positions_m()[12, hand] + np.array([0.02, -0.03, 0.02], np.float32)
    spec = {"kind": "joint_targets", "frame": 112, "joints": [hand], "positions_m": [place.tolist()]}
    text, told = write_constraint_list([target(1, **spec)], take)
    limb, way = again(text, take, tmp_path)
    assert isinstance(limb, JointTargets)
    assert isinstance(way, Waypoint)
    np.testing.assert_allclose(limb.positions_m[list(limb.joints).index(hand)], place, atol=5e-3)
    assert "written with the pose of the take" in told[0]


def test_a_constraint_placed_by_the_server_is_written_at_its_placement(take: Motion, tmp_path: Path) -> None:
    """A metre ahead of a character that faces +X is a metre further along +X."""
    placed = Placement(1, 105, 125, 118, 105, 2.0, 3.0, np.pi / 2)
    relative = {"kind": "waypoint", "frame": 0, "x_m": 0.0, "z_m": 1.0, "at_any_frame": True, "is_relative": True}
    text, told = write_constraint_list([target(1, placement=placed, **relative), target(2, **relative)], take)
    (found,) = again(text, take, tmp_path)
    assert isinstance(found, RootTrajectory)
    assert found.first_frame == 18
    np.testing.assert_allclose(found.positions_m[0], [3.0, 3.0], atol=1e-6)
    assert told == ["constraint 2, waypoint: the server has not placed it yet"]


def test_a_list_can_be_moved_to_start_at_a_frame(take: Motion) -> None:
    entries = [{"type": "root2d", "frame_indices": [0, 1, 7], "root_2d": [[0, 0], [0, 1], [2, 3]]}]
    path, place = moved(read_list(json.dumps(entries).encode(), take.rig, 400), 200)
    assert (path["first_frame"], place["first_frame"]) == (200, 207)
    with pytest.raises(InvalidInput, match="JSON"):
        read_list(b"{", take.rig, 400)
