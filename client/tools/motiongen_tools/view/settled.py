"""Targets after placement: at frames of the session and at places in the world."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from motiongen_client.kinematics import matrix_to_quaternion, quaternion_to_matrix
from motiongen_client.types import (
    Flexible,
    FootContact,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Placement,
    RootPath,
    RootTrajectory,
    Waypoint,
)
from motiongen_client.types import Target as Wanted
from motiongen_tools.view.constraint_json import read_constraint
from motiongen_tools.view.script import Target


def settled(target: Target) -> Wanted | None:
    """What a target asks for, once the server has said when and from where; None until then."""
    constraint = read_constraint(target.spec)
    if not isinstance(constraint, Flexible):
        return constraint
    placement, wanted = target.placement, constraint.target
    if placement is None:
        leaves_open = constraint.at_any_frame or constraint.frames_from_effect or constraint.is_relative
        return None if leaves_open else wanted
    if constraint.is_relative:
        wanted = _in_world(wanted, placement)
    if isinstance(wanted, RootPath):
        return wanted
    if isinstance(wanted, RootTrajectory):
        return dataclasses.replace(wanted, first_frame=placement.first_frame)
    return dataclasses.replace(wanted, frame=placement.arrival_frame)


def _in_world(wanted: Wanted, placement: Placement) -> Wanted:
    """Transform from the character's view when the target took effect (x to its left, z ahead of it) to the world."""
    heading = placement.anchor_heading_rad
    cos, sin = np.cos(heading), np.sin(heading)
    turn = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    here = np.array([placement.anchor_x_m, 0, placement.anchor_z_m])

    def ground(places: Any) -> Any:
        return (np.asarray(places) @ turn[np.ix_([0, 2], [0, 2])].T + here[[0, 2]]).astype(np.float32)

    def turned(rotations: Any) -> Any:
        given = np.asarray(rotations, np.float64)
        is_free = np.linalg.norm(given, axis=-1) < 1e-6  # four zeros leave a joint's rotation free
        moved = matrix_to_quaternion(turn @ quaternion_to_matrix(np.where(is_free[:, None], [1.0, 0, 0, 0], given)))
        return np.where(is_free[:, None], 0.0, moved).astype(np.float32)

    match wanted:
        case Waypoint(x_m=x, z_m=z, heading_rad=faces) | FootContact(x_m=x, z_m=z, heading_rad=faces):
            x, z = ground([x, z]).tolist()
            return dataclasses.replace(wanted, x_m=x, z_m=z, heading_rad=None if faces is None else faces + heading)
        case HeadingTarget(heading_rad=faces):
            return dataclasses.replace(wanted, heading_rad=faces + heading)
        case RootTrajectory(positions_m=places, headings_rad=headings):
            facing = None if headings is None else headings + np.float32(heading)
            return dataclasses.replace(wanted, positions_m=ground(places), headings_rad=facing)
        case RootPath(corners_m=corners):
            return dataclasses.replace(wanted, corners_m=ground(corners))
        case JointRotations(rotations_quat_wxyz=rotations):
            return dataclasses.replace(wanted, rotations_quat_wxyz=turned(rotations))
        case Keyframe(positions_m=places):
            return dataclasses.replace(wanted, positions_m=(places @ turn.T + here).astype(np.float32))
        case JointTargets(positions_m=places, rotations_quat_wxyz=rotations):
            moved = (places @ turn.T + here).astype(np.float32)
            return dataclasses.replace(
                wanted, positions_m=moved, rotations_quat_wxyz=None if rotations is None else turned(rotations)
            )
