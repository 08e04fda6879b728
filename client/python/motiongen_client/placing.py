"""Constraints as the server has placed them: in frames of the session and in world coordinates. Pure.

A session opened anew is given these: a constraint asked for "from here" must not be repeated from another place.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motiongen.v1 import motion_pb2
from motiongen_client.types import Placement

Float64 = NDArray[np.float64]


def placed(target: motion_pb2.Constraint, placement: Placement) -> motion_pb2.Constraint:
    """The same constraint with nothing relative to where or when it took effect."""
    moved = motion_pb2.Constraint()
    moved.CopyFrom(target)
    if target.relative_to_character:
        _into_world(moved, placement)
        moved.relative_to_character = False
    if target.frames_from_effect:
        moved.frame = target.frame + placement.anchor_frame
        if target.HasField("last_frame"):
            moved.last_frame = target.last_frame + placement.anchor_frame
        moved.frames_from_effect = False
    return moved


def path_left(target: motion_pb2.Constraint, placement: Placement, frame: int) -> motion_pb2.Constraint:
    """What is left of a placed path at a frame: the corners ahead, judged by the elapsed share of its frames."""
    corners = np.array(target.root_path.positions, np.float64).reshape(-1, 2)
    start = np.array([[placement.anchor_x_m, placement.anchor_z_m]])
    way_m = np.cumsum(np.hypot(*np.diff(np.concatenate([start, corners]), axis=0).T))
    share = (frame - placement.first_frame) / max(placement.last_frame - placement.first_frame, 1)
    passed = int(np.sum(way_m[:-1] < share * way_m[-1]))
    left = motion_pb2.Constraint()
    left.CopyFrom(target)
    del left.root_path.positions[: 2 * passed]
    return left


def _into_world(target: motion_pb2.Constraint, seen_from: Placement) -> None:
    heading = seen_from.anchor_heading_rad
    cos, sin = math.cos(heading), math.sin(heading)
    here = np.array([seen_from.anchor_x_m, 0.0, seen_from.anchor_z_m])
    turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])

    def points(positions: ArrayLike) -> list[float]:
        moved = np.reshape(positions, (-1, 3)) @ turn.T + here
        return [float(number) for number in moved.ravel()]

    def ground(positions: ArrayLike) -> list[float]:
        flat = np.reshape(positions, (-1, 2))
        moved = np.reshape(points(np.insert(flat, 1, 0.0, axis=1)), (-1, 3))
        return [float(number) for number in moved[:, [0, 2]].ravel()]

    match target.WhichOneof("target"):
        case "waypoint":
            waypoint = target.waypoint
            waypoint.x, waypoint.z = ground([waypoint.x, waypoint.z])
            if waypoint.HasField("heading"):
                waypoint.heading += heading
        case "foot_contact":
            foot = target.foot_contact
            foot.x, foot.z = ground([foot.x, foot.z])
            if foot.HasField("heading"):
                foot.heading += heading
        case "heading":
            target.heading.heading += heading
        case "root_trajectory":
            trajectory = target.root_trajectory
            trajectory.positions[:] = ground(trajectory.positions)
            trajectory.headings[:] = [each + heading for each in trajectory.headings]
        case "root_path":
            target.root_path.positions[:] = ground(target.root_path.positions)
        case "keyframe":
            target.keyframe.positions[:] = points(target.keyframe.positions)
        case "joint_targets":
            target.joint_targets.positions[:] = points(target.joint_targets.positions)
            target.joint_targets.rotations[:] = _turned(target.joint_targets.rotations, heading)
        case "joint_rotations":
            target.joint_rotations.rotations[:] = _turned(target.joint_rotations.rotations, heading)


def _turned(rotations: ArrayLike, heading: float) -> list[float]:
    """A flat list of quaternions w x y z, turned about the up axis by a heading; one of zeros stays zero."""
    w, x, y, z = np.reshape(np.asarray(rotations, np.float64), (-1, 4)).T
    cos, sin = math.cos(heading / 2), math.sin(heading / 2)
    turned = np.stack([cos * w - sin * y, cos * x + sin * z, cos * y + sin * w, cos * z - sin * x], axis=-1)
    return [float(number) for number in turned.ravel()]
