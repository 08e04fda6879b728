"""Placing: constraints relative to a character, or without a frame, become frames and places of the world."""

import math

import numpy as np
import pytest

from motiongen_ardy.locomotion.velocity import RootState
from motiongen_server.engine.session.placing import REACH, Anchor, moved, placed, root_for
from motiongen_server.engine.types import (
    Constraint,
    EventRefused,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RigLayout,
    RootPath,
    RootTrajectory,
    Span,
    Unplaced,
    Waypoint,
)
from motiongen_server.engine.types.rotations import rotation_matrices

# The character stands at (3, 5) and faces +X, so that its left is -Z.
ROOT = RootState(3.0, 5.0, 0.0, 0.0, math.pi / 2)
# a root, and an arm of 1.2 m
RIG = RigLayout("arm", ("root", "arm", "hand"), (-1, 0, 1), np.array([[0, 0, 0], [0, 0.7, 0], [0.5, 0, 0]]), ())
ANCHOR = Anchor(100, ROOT, 20, RIG)


def vectors(*rows: tuple[float, ...]) -> np.ndarray:
    return np.array(rows, np.float32)


def test_relative_waypoint_ahead_lies_where_the_character_faces() -> None:
    found = moved(Waypoint(1, 60, 0.5, 2.0, heading=-math.pi / 2), ROOT)
    assert isinstance(found, Waypoint)
    assert found.heading is not None
    assert (found.x, found.z, found.heading) == pytest.approx((5.0, 4.5, 0.0))


def test_every_kind_of_constraint_can_be_relative_to_the_character() -> None:
    quarter = rotation_matrices(np.array([[math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0]]))[0]
    heading = moved(HeadingTarget(1, 60, 0.25), ROOT)
    assert isinstance(heading, HeadingTarget)
    assert heading.heading == pytest.approx(0.25 + math.pi / 2)
    path = moved(RootTrajectory(1, 60, vectors((0, 1), (0, 2)), np.zeros(2, np.float32)), ROOT)
    assert isinstance(path, RootTrajectory)
    assert path.heading is not None
    assert np.allclose(path.xz, [(4, 5), (5, 5)])
    assert np.allclose(path.heading, math.pi / 2)
    way = moved(RootPath(1, vectors((0, 1)), 1.0, 0.1), ROOT)
    assert isinstance(way, RootPath)
    assert np.allclose(way.corners, [(4, 5)])
    pose = moved(Keyframe(1, 60, vectors((0, 0.9, 1))), ROOT)
    assert isinstance(pose, Keyframe)
    assert np.allclose(pose.positions, [(4, 0.9, 5)])
    turned = moved(JointRotations(1, 60, (0,), np.eye(3, dtype=np.float32)[None]), ROOT)
    assert isinstance(turned, JointRotations)
    assert np.allclose(turned.rotations[0], quarter, atol=1e-6)
    hand = moved(JointTargets(1, 60, (0,), vectors((0, 1, 1)), np.eye(3, dtype=np.float32)[None]), ROOT)
    assert isinstance(hand, JointTargets)
    assert hand.rotations is not None
    assert np.allclose(hand.positions, [(4, 1, 5)])
    assert np.allclose(hand.rotations[0], quarter, atol=1e-6)


def test_frames_from_effect_count_from_the_anchor_frame() -> None:
    found, placement = placed(Unplaced(Waypoint(1, 30, 0.0, 0.0), frames_from_effect=True), ANCHOR, "f")
    assert (found.first_frame, found.last_frame, placement.arrival_frame) == (130, 130, 130)
    assert (placement.anchor_frame, placement.x, placement.z) == (100, 3.0, 5.0)
    path = RootTrajectory(1, 30, np.zeros((5, 2), np.float32))
    found, placement = placed(Unplaced(path, frames_from_effect=True), ANCHOR, "f")
    assert (found.first_frame, found.last_frame) == (130, 134)


@pytest.mark.parametrize(("first", "last", "aims_at"), [(110, 400, "soonest"), (110, 120, "last"), (300, 400, "first")])
def test_waypoint_with_several_frames_aims_for_the_soonest_possible_one(first: int, last: int, aims_at: str) -> None:
    asked = Waypoint(1, first, 9.0, 5.0)
    found, placement = placed(Unplaced(asked, last_frame=last), ANCHOR, "f")
    soonest = ANCHOR.first_possible(9.0, 5.0, None)
    assert 190 < soonest < 250  # six metres
    assert isinstance(found, Waypoint)
    assert found.span == Span(first, last)
    assert found.frame == placement.arrival_frame == {"soonest": soonest, "last": last, "first": first}[aims_at]


def test_waypoint_at_any_frame_aims_for_the_soonest_and_may_be_met_later() -> None:
    found, placement = placed(Unplaced(Waypoint(1, 0, 9.0, 5.0), at_any_frame=True), ANCHOR, "f")
    assert isinstance(found, Waypoint)
    assert found.span is not None
    assert (found.span.first, found.span.is_led) == (100, True)
    assert found.frame == ANCHOR.first_possible(9.0, 5.0, None) < found.span.last == placement.last_frame


def test_constraints_of_a_clip_are_placed_within_its_frames() -> None:
    clip = Anchor(0, ROOT, 20, RIG, last_frame=59)
    found, _ = placed(Unplaced(Waypoint(1, 0, 90.0, 5.0), at_any_frame=True), clip, "f")
    assert (found.last_frame, found.first_frame) == (59, 0)
    found, _ = placed(Unplaced(RootPath(1, vectors((90, 5)), 1.0, 0.1)), clip, "f")
    assert (found.first_frame, found.last_frame) == (0, 59)


def test_root_path_becomes_a_trajectory_from_where_the_character_is() -> None:
    found, placement = placed(Unplaced(RootPath(7, vectors((9, 5), (9, 9)), 1.5, 0.2, weight=2.0)), ANCHOR, "f")
    assert isinstance(found, RootTrajectory)
    assert (found.constraint_id, found.weight, found.first_frame) == (7, 2.0, 100)
    assert np.allclose(found.xz[-1], (9, 9), atol=1e-5)
    assert np.hypot(*(found.xz[0] - (3, 5))) < 0.1
    assert placement.last_frame == placement.arrival_frame == found.last_frame


@pytest.mark.parametrize("asked", [{"frame": 2**53}, {"frame": 30, "last_frame": 2**53}], ids=["first", "last"])
def test_frames_out_of_range_are_refused(asked: dict[str, int]) -> None:
    target = Unplaced(Waypoint(1, asked["frame"], 0.0, 0.0), True, last_frame=asked.get("last_frame"))
    with pytest.raises(EventRefused) as refused:
        placed(target, ANCHOR, "edit_constraints.upsert[4]")
    assert (refused.value.reason, refused.value.field) == ("FRAME_OUT_OF_RANGE", "edit_constraints.upsert[4].frame")


def test_path_that_takes_too_long_is_refused_naming_its_field() -> None:
    with pytest.raises(EventRefused, match="it takes 2000 s") as refused:
        placed(Unplaced(RootPath(7, vectors((2003, 5)), 1.0, 0.2)), ANCHOR, "edit_constraints.upsert[4]")
    assert (refused.value.reason, refused.value.field) == ("PATH_TOO_LONG", "edit_constraints.upsert[4].root_path")


@pytest.mark.parametrize(("hand", "root"), [((3.2, 5.0), (3.0, 5.0)), ((8.0, 5.0), (8.0 - REACH * 1.2, 5.0))])
def test_root_for_joint_targets_comes_only_as_near_as_they_reach(
    hand: tuple[float, float], root: tuple[float, float]
) -> None:
    target = JointTargets(1, 60, (2,), vectors((hand[0], 1.0, hand[1])))
    assert root_for(target, 3.0, 5.0, RIG) == pytest.approx(root)


def test_relative_constraint_with_a_frame_keeps_its_frame() -> None:
    asked: Constraint = HeadingTarget(1, 30, 0.5)
    found, placement = placed(Unplaced(asked, is_relative=True), ANCHOR, "f")
    assert found.first_frame == found.last_frame == placement.arrival_frame == 30
