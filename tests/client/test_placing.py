"""Constraints that leave a choice to the server: how they are sent, reported, and sent again after a loss."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client import (
    Flexible,
    HeadingTarget,
    InvalidInput,
    JointTargets,
    Motion,
    Placement,
    Priority,
    RootPath,
    StartPose,
    Waypoint,
    convert,
)
from motiongen_client.placing import placed
from motiongen_client.wishes import Wishes

# The character stood at (3, 5) and faced +X, so that its left is -Z.
HERE = Placement(7, 100, 170, 140, 100, 3.0, 5.0, math.pi / 2)


def test_flexible_constraints_and_paths_are_sent_with_all_their_fields() -> None:
    message = convert.constraint(
        7, Flexible(Waypoint(40, 1.0, 2.0), 80, frames_from_effect=True, is_relative=True, weight=0.5)
    )
    assert (message.frame, message.last_frame, message.weight) == (40, 80, 0.5)
    assert message.frames_from_effect
    assert message.relative_to_character
    assert not message.at_any_frame
    assert convert.constraint(7, Flexible(HeadingTarget(0, 1.0), at_any_frame=True)).at_any_frame
    path = convert.constraint(7, RootPath([[1.0, 2.0], [3.0, 4.0]], speed_mps=2.0))
    assert list(path.root_path.positions) == [1, 2, 3, 4]
    assert path.root_path.speed_mps == 2.0
    assert not path.root_path.HasField("smoothing_m")
    assert not convert.constraint(7, Waypoint(4, 0.0, 0.0)).HasField("weight")


@pytest.mark.parametrize("weight", [0, -1, 10.5])
def test_invalid_weight_is_refused(weight: float) -> None:
    with pytest.raises(InvalidInput, match="weight"):
        Flexible(Waypoint(4, 0.0, 0.0), weight=weight)


@pytest.mark.parametrize("corners", [[], [[1.0, math.nan]], [[1.0, 2.0, 3.0]]])
def test_path_with_invalid_corners_is_refused(corners: list[list[float]]) -> None:
    with pytest.raises(InvalidInput, match="corners_m"):
        RootPath(corners if corners else np.zeros((0, 2)))


def test_joint_targets_need_at_least_one_joint_but_not_the_root() -> None:
    assert JointTargets(4, [3], [[0.0, 1.0, 0.0]]).joints == (3,)
    with pytest.raises(InvalidInput, match="joints"):
        JointTargets(4, [], np.zeros((0, 3)))


def test_placements_in_outcomes_are_in_frames_of_the_application() -> None:
    message = session_pb2.EditOutcome(event_seq=4, effective_frame=10)
    message.placements.add(
        constraint_id=7, first_frame=10, last_frame=80, arrival_frame=50, anchor_frame=10, anchor_x=3
    )
    outcome = convert.outcome(message, "it", 100)
    assert not isinstance(outcome, Exception)
    (placement,) = outcome.placements
    assert (placement.first_frame, placement.arrival_frame, placement.last_frame) == (110, 150, 180)
    assert (placement.anchor_frame, placement.anchor_x_m) == (110, 3.0)


def test_placed_relative_constraint_becomes_one_in_world_coordinates() -> None:
    found = placed(convert.constraint(7, Flexible(Waypoint(0, 0.5, 2.0, -math.pi / 2), is_relative=True)), HERE)
    assert not found.relative_to_character
    assert (found.waypoint.x, found.waypoint.z, found.waypoint.heading) == pytest.approx((5.0, 4.5, 0.0), abs=1e-6)
    hand = JointTargets(0, [3], [[0.0, 1.0, 1.0]], [[1.0, 0.0, 0.0, 0.0]])
    found = placed(convert.constraint(7, Flexible(hand, is_relative=True)), HERE)
    assert list(found.joint_targets.positions) == pytest.approx([4.0, 1.0, 5.0], abs=1e-6)
    quarter = [math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0]
    assert list(found.joint_targets.rotations) == pytest.approx(quarter, abs=1e-6)
    found = placed(convert.constraint(7, Flexible(HeadingTarget(0, 0.25), is_relative=True)), HERE)
    assert found.heading.heading == pytest.approx(0.25 + math.pi / 2)
    for kind in (
        motion_pb2.Constraint(keyframe=motion_pb2.Keyframe(positions=[0, 1, 1])),
        motion_pb2.Constraint(root_trajectory=motion_pb2.RootTrajectory(positions=[0, 1], headings=[0.5])),
        motion_pb2.Constraint(joint_rotations=motion_pb2.JointRotations(joints=[0], rotations=[1, 0, 0, 0])),
        motion_pb2.Constraint(root_path=motion_pb2.RootPath(positions=[0, 1])),
    ):
        kind.relative_to_character = True
        found = placed(kind, HERE)
        assert found != kind
        assert not found.relative_to_character


def test_cut_is_sent_as_a_start_pose_or_as_prior_frames(stick_motion: Motion) -> None:
    pose = convert.seek(StartPose(1.0, 2.0, 0.5), None).start_pose
    assert (pose.x, pose.z, pose.heading) == (1.0, 2.0, 0.5)
    seek = convert.seek(None, stick_motion)
    assert not seek.HasField("start_pose")
    assert seek.prior_frames.frame_count == len(stick_motion)
    assert convert.FrameReader(stick_motion.rig).rows(seek.prior_frames) == pytest.approx(stick_motion.rows)


def test_changed_options_are_sent_without_the_others() -> None:
    message = convert.set_options(None, None, 6, (None, 2.0), None)
    assert [field.name for field, _ in message.ListFields()] == ["denoise_steps", "guidance"]
    assert not message.guidance.HasField("text")
    assert convert.set_options(Priority.HERO, None, None, None, 8).priority == session_pb2.PRIORITY_CLASS_HERO


def test_placed_frames_from_effect_become_frames_of_the_session() -> None:
    found = placed(convert.constraint(7, Flexible(Waypoint(30, 0.0, 0.0), 60, frames_from_effect=True)), HERE)
    assert (found.frame, found.last_frame, found.frames_from_effect) == (130, 160, False)


def told(*upsert: motion_pb2.Constraint) -> Wishes:
    """The wishes of a session with these constraints, and with the placement of the one with the id 7."""
    wishes = Wishes()
    event = session_pb2.SessionEvent(edit_constraints=session_pb2.EditConstraints(upsert=upsert))
    wishes.take(event, 100, 90, [HERE])
    return wishes


def test_reopened_session_is_sent_placed_constraints_until_their_last_frame() -> None:
    soon = convert.constraint(7, Flexible(Waypoint(0, 0.0, 2.0), at_any_frame=True, is_relative=True))
    (left,) = told(soon).constraints_from(120)
    assert (left.at_any_frame, left.relative_to_character) == (True, False)
    assert (left.waypoint.x, left.waypoint.z) == pytest.approx((5.0, 5.0))
    assert told(soon).constraints_from(171) == [], "it was over at frame 170"
    window = convert.constraint(7, Flexible(Waypoint(60, 0.0, 2.0), 150))
    (left,) = told(window).constraints_from(120)
    assert (left.frame, left.last_frame) == (0, 30)
    assert told(window).constraints_from(160) == []


@pytest.mark.parametrize(("frame", "corners"), [(100, [4, 5, 6, 5, 8, 5]), (137, [6, 5, 8, 5]), (170, [8, 5])])
def test_path_that_has_begun_keeps_only_the_corners_ahead(frame: int, corners: list[float]) -> None:
    wishes = told(convert.constraint(7, RootPath([[4.0, 5.0], [6.0, 5.0], [8.0, 5.0]])))
    (left,) = wishes.constraints_from(frame)
    assert list(left.root_path.positions) == corners
