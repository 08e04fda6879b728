"""The protocol's constraints -> the engine's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import motion_pb2
from motiongen_server.engine.types import (
    DEFAULT_TOLERANCE,
    Asked,
    Constraint,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RootPath,
    RootTrajectory,
    Tolerance,
    Waypoint,
)
from motiongen_server.engine.types.rotations import rotation_matrices_of_few
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert.checks import (
    check_coordinates,
    check_count,
    check_finite,
    finite_heading,
    finite_headings,
    frame_number,
    heading_of,
    identifier_of,
    number_array,
    points,
    refuse,
)
from motiongen_server.rpc.convert.foot_contact import foot_contact_of
from motiongen_server.rpc.convert.forms import check_forms
from motiongen_server.rpc.convert.placing import asked_of, path_of

UNIT_TOLERANCE = 1e-3
MAX_TOLERANCE_RAD = 3.15
"""Headings and rotations differ by pi at most; pi as a float32 is a little more."""


def constraints_of(messages: Sequence[motion_pb2.Constraint], field: str, catalog: Catalog) -> tuple[Asked, ...]:
    check_count(messages, catalog.limits.max_constraints, "TOO_MANY_CONSTRAINTS", field)
    constraints = []
    for index, message in enumerate(messages):
        target = _constraint(message, f"{field}[{index}]", catalog)
        if isinstance(target, RootTrajectory):
            frame_number(target.last_frame, f"{field}[{index}].frame")
        target = replace(target, tolerance=_tolerance(message, f"{field}[{index}]"))
        check_forms(target, f"{field}[{index}]", catalog)
        constraints.append(asked_of(message, target, f"{field}[{index}]"))
    return tuple(constraints)


def _constraint(message: motion_pb2.Constraint, field: str, catalog: Catalog) -> Constraint | RootPath:
    identifier = identifier_of(message.constraint_id, f"{field}.constraint_id")
    frame = frame_number(message.frame, f"{field}.frame")
    target = message.WhichOneof("target")
    if target == "waypoint":
        waypoint = message.waypoint
        check_coordinates((waypoint.x,), f"{field}.waypoint.x")
        check_coordinates((waypoint.z,), f"{field}.waypoint.z")
        return Waypoint(identifier, frame, waypoint.x, waypoint.z, heading_of(waypoint, f"{field}.waypoint"))
    if target == "root_trajectory":
        return _trajectory(message.root_trajectory, identifier, frame, f"{field}.root_trajectory", catalog)
    if target == "joint_targets":
        return _joint_targets(message.joint_targets, identifier, frame, f"{field}.joint_targets", catalog)
    if target == "keyframe":
        joints = len(catalog.facts.rig.joint_names)
        positions = points(message.keyframe.positions, joints, 3, f"{field}.keyframe.positions")
        return Keyframe(identifier, frame, positions)
    if target == "heading":
        return HeadingTarget(identifier, frame, finite_heading(message.heading.heading, f"{field}.heading"))
    if target == "joint_rotations":
        return _joint_rotations(message.joint_rotations, identifier, frame, f"{field}.joint_rotations", catalog)
    if target == "root_path":
        return path_of(message.root_path, identifier, f"{field}.root_path")
    if target == "foot_contact":
        contact = message.foot_contact
        return foot_contact_of(contact, identifier, frame, f"{field}.foot_contact", catalog.facts.rig)
    allowed = "waypoint, joint_targets, keyframe, root_trajectory, heading, joint_rotations, root_path or foot_contact"
    raise refuse("NO_TARGET", f"{field}.target", "no target is set", allowed)


def _tolerance(message: motion_pb2.Constraint, field: str) -> Tolerance:
    """The tolerances of the message, or the defaults of those that it leaves out."""
    position_m, angle_rad = DEFAULT_TOLERANCE.position_m, DEFAULT_TOLERANCE.angle_rad
    if message.HasField("tolerance_m"):
        position_m = _within(message.tolerance_m, math.inf, f"{field}.tolerance_m", "finite metres, 0 or more")
    if message.HasField("tolerance_rad"):
        angle_rad = _within(message.tolerance_rad, MAX_TOLERANCE_RAD, f"{field}.tolerance_rad", "radians, 0 to pi")
    return Tolerance(position_m, angle_rad)


def _within(value: float, most: float, field: str, allowed: str) -> float:
    if not math.isfinite(value):
        raise refuse("NOT_FINITE", field, f"the tolerance is {value}", allowed)
    if not 0 <= value <= most:
        raise refuse("TOLERANCE_OUT_OF_RANGE", field, f"the tolerance is {value:g}", allowed)
    return value


def _trajectory(
    message: motion_pb2.RootTrajectory, identifier: int, frame: int, field: str, catalog: Catalog
) -> RootTrajectory:
    most = catalog.limits.max_trajectory_frames
    count = len(message.positions) // 2
    if not 1 <= count <= most or len(message.positions) % 2:
        raise refuse(
            "WRONG_LENGTH",
            f"{field}.positions",
            f"there are {len(message.positions)} numbers",
            f"2 numbers (x, z) a frame, 1 to {most} frames",
        )
    headings = None
    if message.headings:
        given = number_array(message.headings, count, f"{field}.headings", "one heading a frame, or none")
        headings = finite_headings(given, f"{field}.headings")
    return RootTrajectory(identifier, frame, points(message.positions, count, 2, f"{field}.positions"), headings)


def _joint_targets(
    message: motion_pb2.JointTargets, identifier: int, frame: int, field: str, catalog: Catalog
) -> JointTargets:
    joints = _joints(message.joints, f"{field}.joints", catalog)
    positions = points(message.positions, len(joints), 3, f"{field}.positions")
    if not message.rotations:
        return JointTargets(identifier, frame, joints, positions)
    quaternions, norms = _quaternions(message.rotations, len(joints), f"{field}.rotations", ", or none")
    rotated = norms > 0
    if not np.all(np.abs(norms[rotated] - 1) <= UNIT_TOLERANCE):
        allowed = "1 within 0.001, or 0 for a rotation that is free"
        raise refuse("NOT_A_ROTATION", f"{field}.rotations", f"quaternion lengths are {norms[:8]}", allowed)
    quaternions[~rotated, 0] = 1.0  # these joints' rotations are ignored, but must be valid
    matrices = rotation_matrices_of_few(quaternions).astype(np.float32)
    return JointTargets(
        identifier, frame, joints, positions, matrices, None if rotated.all() else tuple(rotated.tolist())
    )


def _joint_rotations(
    message: motion_pb2.JointRotations, identifier: int, frame: int, field: str, catalog: Catalog
) -> JointRotations:
    joints = _joints(message.joints, f"{field}.joints", catalog)
    quaternions, norms = _quaternions(message.rotations, len(joints), f"{field}.rotations", "")
    if not np.all(np.abs(norms - 1) <= UNIT_TOLERANCE):
        given = f"quaternion lengths are {norms[:8]}"
        raise refuse("NOT_A_ROTATION", f"{field}.rotations", given, "1 within 0.001")
    return JointRotations(identifier, frame, joints, rotation_matrices_of_few(quaternions).astype(np.float32))


def _joints(given: Sequence[int], field: str, catalog: Catalog) -> tuple[int, ...]:
    """Indices of the rig's joints, one or more, each at most once."""
    last = len(catalog.facts.rig.joint_names) - 1
    if len(given) > last + 1:
        what = f"there are {len(given)}"
        raise refuse("INVALID_JOINTS", field, what, f"one or more of 0 to {last}, each at most once")
    joints = tuple(given)
    if not joints or any(joint > last for joint in joints) or len(set(joints)) != len(joints):
        what = f"joints {joints[:40]}" if joints else "there are none"
        raise refuse("INVALID_JOINTS", field, what, f"one or more of 0 to {last}, each at most once")
    return joints


def _quaternions(
    values: Sequence[float], num_joints: int, field: str, otherwise: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quaternions (K, 4) of finite numbers, and their lengths (K). otherwise: what may be given instead, in words."""
    count = 4 * num_joints
    numbers = number_array(values, count, field, f"{count} numbers (w, x, y, z a joint){otherwise}")
    check_finite(numbers, field, "finite numbers")
    quaternions = numbers.reshape(-1, 4).astype(np.float64)  # squares of large float32 numbers fit
    return quaternions, np.linalg.norm(quaternions, axis=1)
