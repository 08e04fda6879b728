"""Goals measured on a known motion: 1 m/s along +Z, facing +Z, for two seconds at 20 frames a second."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motiongen_client import JointTargets, Motion, RootTrajectory, Waypoint
from motiongen_tools.demo.direct import Here, circle_m, here
from motiongen_tools.demo.goals import Aim, Facing, Goal, Pace, measure
from motiongen_tools.demo.report import Deed, deeds
from motiongen_tools.demo.script import Circle


@pytest.mark.parametrize(
    ("aim", "error", "reached_s"),
    [
        (Waypoint(20, 1.0, 1.1), 10.0, 0.9),
        (Waypoint(20, 1.3, 1.4), 50.0, None),
        (RootTrajectory(10, np.array([[1.0, 0.6]] * 5)), 6.0, 0.4),  # the mean of 10, 5, 0, 5 and 10 cm
        (Facing(20, math.radians(10)), 10.0, 0.0),
        (Facing(20, math.radians(-170)), 170.0, None),
        (Pace(0, 20, 0.0, 1.0), 0.0, 0.0),
        (Pace(0, 20, 1.0, 1.0), 1.0, None),
    ],
)
def test_errors_and_times_of_arrival_are_measured(
    stick_motion: Motion, aim: Aim, error: float, reached_s: float | None
) -> None:
    reached = measure(Goal("a goal", 0, aim), stick_motion, place_m=0.2)
    assert reached is not None
    assert reached.error == pytest.approx(error, abs=1e-3)
    assert reached.is_within == (reached_s is not None)
    assert reached.reached_s == (None if reached_s is None else pytest.approx(reached_s, abs=0.051))


def test_the_error_of_a_hand_goal_ignores_the_root(stick_motion: Motion) -> None:
    hand = stick_motion.rig.index("RightHand")
    place = stick_motion.frame(20).joint_positions_m()[hand] + [0, 0.3, 0]
    targets = JointTargets(20, (0, hand), np.array([[9, 9, 9], place]))
    reached = measure(Goal("reach", 0, targets), stick_motion, place_m=0.2)
    assert reached is not None
    assert reached.error == pytest.approx(30, abs=1e-3)
    assert not reached.is_within


@pytest.mark.parametrize("aim", [Waypoint(40, 0, 0), Pace(30, 41, 0, 1), Facing(100, 0)])
def test_goals_due_after_the_end_are_not_judged(stick_motion: Motion, aim: Aim) -> None:
    assert measure(Goal("later", 0, aim), stick_motion, place_m=0.2) is None


def test_only_waypoints_are_places() -> None:
    assert Goal("", 0, Waypoint(1, 0, 0)).is_place
    assert not Goal("", 0, Facing(1, 0)).is_place


def test_places_are_relative_to_the_path_or_if_standing_to_the_heading(stick_motion: Motion) -> None:
    rows = stick_motion.rows.copy()
    rows[:, 0], rows[:, 3:7] = 0, [math.cos(math.pi / 4), 0, math.sin(math.pi / 4), 0]  # faces +X, goes to +Z
    moving = here(Motion(stick_motion.rig, 0, rows))
    assert moving.frame == 39
    assert moving.off(2, 0) == pytest.approx((0, 3.95), abs=1e-4)
    assert moving.off(2, 90) == pytest.approx((2, 1.95), abs=1e-4)  # +X is to the left of +Z
    rows[:, 2] = 0
    assert here(Motion(stick_motion.rig, 0, rows)).off(2, 0) == pytest.approx((2, 0), abs=1e-4)


def test_a_circle_starts_from_rest_along_the_heading_and_keeps_its_radius() -> None:
    at = Here(0, np.array([1.0, 0.9, 2.0]), 0.0, 0.0)
    path = circle_m(Circle(1.5, 1.0, 12.0), at, 20).astype(np.float64)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1) * 20
    assert path[0] == pytest.approx((1, 2))
    assert path[10, 1] > 2.0  # on along +Z
    assert path[:, 0].max() == pytest.approx(4.0, abs=0.01)  # to the left
    assert np.hypot(path[:, 0] - 2.5, path[:, 1] - 2) == pytest.approx(1.5, abs=1e-4)
    assert steps[0] < 0.1
    assert steps[25:] == pytest.approx(1.0, abs=0.01)


def test_deeds_describe_the_motion_under_each_prompt(stick_motion: Motion) -> None:
    rows = stick_motion.rows.copy()
    rows[:, 0] = 0
    first, second = deeds(Motion(stick_motion.rig, 0, rows), [(0, "stand"), (20, "walk"), (60, "later")])
    assert (first.from_s, first.to_s, second.from_s, second.to_s) == (0, 1, 1, 2)
    assert (second.text, second.travelled_m) == ("walk", pytest.approx(0.95, abs=1e-4))
    assert second.turned_deg == pytest.approx(0, abs=1e-4)


def test_a_turn_is_told_in_whole_degrees_without_a_sign_at_zero() -> None:
    turned = [Deed(0, 1, "stand", 0.0, degrees).turned for degrees in (-0.4, -89.7, 12.2)]
    assert turned == ["0 degrees", "-90 degrees", "12 degrees"]
