"""Constraints to JSON and back, and the fields that are named when one is wrong."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from motiongen_client import (
    Flexible,
    FootContact,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RootPath,
    RootTrajectory,
    Waypoint,
)
from motiongen_client.errors import InvalidInput
from motiongen_client.types import Constraint
from motiongen_tools.view.constraint_json import frames_of, read_constraint, write_constraint

ALL = [
    Waypoint(30, 1.0, 2.0, 0.5, tolerance_m=0.2),
    Waypoint(30, 1.0, 2.0),
    RootTrajectory(10, np.array([[0, 1], [0, 2]], np.float32), np.array([0, 0.5], np.float32)),
    Keyframe(5, np.zeros((9, 3), np.float32)),
    JointTargets(8, [0, 4], np.ones((2, 3), np.float32)),
    HeadingTarget(9, -1.5, tolerance_rad=0.1),
    JointRotations(7, [2], np.array([[1, 0, 0, 0]], np.float32)),
    RootPath(np.array([[1, 2], [3, 4]], np.float32), speed_mps=1.5),
    Flexible(Waypoint(0, 1.0, 2.0), at_any_frame=True, weight=0.5),
    Flexible(HeadingTarget(30, 1.0), last_frame=40),
    FootContact(30, "LeftFoot", 0.1, 0.2, heading_rad=0.3),
]


@pytest.mark.parametrize("constraint", ALL, ids=lambda each: type(each).__name__)
def test_every_kind_of_constraint_round_trips(constraint: Constraint) -> None:
    written = json.loads(json.dumps(write_constraint(constraint)))
    again = read_constraint(written)
    assert type(again) is type(constraint)
    for name, value in vars(constraint).items():
        if name == "target":
            assert getattr(again, name) == value
        else:
            np.testing.assert_array_equal(getattr(again, name), value)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"kind": "wish"}, "kind"),
        ({"kind": "waypoint", "frame": 3, "x_m": 0, "z_m": 0, "y_m": 0}, "y_m"),
        ({"kind": "waypoint", "frame": 3, "x_m": "far", "z_m": 0}, "x_m"),
        ({"kind": "waypoint", "frame": 3}, "waypoint"),
        ({"kind": "keyframe", "frame": -1, "positions_m": [[0, 0, 0]]}, "frame"),
        ({"kind": "joint_targets", "frame": 1, "joints": [0], "positions_m": [[0, 0]]}, "positions_m"),
        ({"kind": "joint_targets", "frame": 1, "joints": 3, "positions_m": []}, "joints"),
    ],
)
def test_a_mistake_is_reported_with_its_field(given: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        read_constraint(given)
    assert refused.value.field == field


def test_first_and_last_frames_of_every_kind_of_constraint() -> None:
    spans = [frames_of(constraint) for constraint in ALL]
    assert spans == [(30, 30), (30, 30), (10, 11), (5, 5), (8, 8), (9, 9), (7, 7), None, None, (30, 40), (30, 30)]
