"""Constraints as browsers and session files write them, to the client's classes and back.

Each is an object with `kind` and the fields of the client's class for it, with lists instead of arrays:

| kind | fields |
|---|---|
| waypoint | frame, x_m, z_m, heading_rad |
| trajectory | first_frame, positions_m, headings_rad |
| keyframe | frame, positions_m |
| joint_targets | frame, joints, positions_m, rotations_quat_wxyz |
| heading | frame, heading_rad |
| joint_rotations | frame, joints, rotations_quat_wxyz |
| path | corners_m, speed_mps, smoothing_m |
| foot_contact | frame, limb, x_m, z_m, heading_rad |

All may have tolerance_m and tolerance_rad, and the fields of `Flexible`: last_frame, at_any_frame, frames_from_effect,
is_relative, weight.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from motiongen_client.errors import InvalidInput
from motiongen_client.types import (
    Constraint,
    Flexible,
    FootContact,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RootPath,
    RootTrajectory,
    Target,
    Waypoint,
)
from motiongen_tools.view.fields import Message, flag, ids, optional_whole, text

KINDS: dict[str, type[Target]] = {
    "waypoint": Waypoint,
    "trajectory": RootTrajectory,
    "keyframe": Keyframe,
    "joint_targets": JointTargets,
    "heading": HeadingTarget,
    "joint_rotations": JointRotations,
    "path": RootPath,
    "foot_contact": FootContact,
}
_NAMES = {kind: name for name, kind in KINDS.items()}
_FLEXIBLE = tuple(field.name for field in fields(Flexible) if field.name != "target")
_FRAMES = ("frame", "first_frame", "last_frame")
_FLAGS = ("at_any_frame", "frames_from_effect", "is_relative")


def read_constraint(message: Message) -> Constraint:
    """The constraint that an object describes. Raises InvalidInput naming the field."""
    given = dict(message)
    kind = KINDS.get(str(given.pop("kind", None)))
    if kind is None:
        raise InvalidInput("kind", message.get("kind"), f"one of {', '.join(KINDS)}")
    known = [field.name for field in fields(kind)]
    for name in given:
        if name not in (*known, *_FLEXIBLE):
            raise InvalidInput(name, given[name], f"only {', '.join((*known, *_FLEXIBLE))} beside kind")
    left_open = {name: given.pop(name) for name in _FLEXIBLE if name in given}
    try:
        target = kind(**given)
        constraint = Flexible(target, **left_open) if left_open else target
    except (TypeError, ValueError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(_NAMES[kind], message, f"the fields {', '.join(known)}") from error
    _check_sendable(message)
    return constraint


def _check_sendable(message: Message) -> None:
    """Refuse values that these classes accept but that do not fit into the messages of the contract."""
    for name in _FRAMES:
        optional_whole(message, name)
    for name in _FLAGS:
        flag(message, name)
    if "joints" in message:
        ids(message, "joints")
    if "limb" in message:
        text(message, "limb")


def write_constraint(constraint: Constraint) -> dict[str, Any]:
    """The object from which `read_constraint` makes an equal constraint."""
    target = constraint.target if isinstance(constraint, Flexible) else constraint
    written: dict[str, Any] = {"kind": _NAMES[type(target)], **_written(target)}
    if isinstance(constraint, Flexible):
        written |= {name: value for name, value in _written(constraint).items() if name in _FLEXIBLE and value}
    return written


def _written(described: Constraint) -> dict[str, Any]:
    written = {}
    for field in fields(described):
        value = getattr(described, field.name)
        if isinstance(value, np.ndarray):
            value = value.tolist()
        elif isinstance(value, tuple):
            value = list(value)
        if value is not None:
            written[field.name] = value
    return written


def frames_of(constraint: Constraint) -> tuple[int, int] | None:
    """The first and the last frame of a constraint; None if the server chooses them."""
    if isinstance(constraint, Flexible):
        frames = frames_of(constraint.target)
        if frames is None or constraint.at_any_frame or constraint.frames_from_effect:
            return None
        return frames[0], max(frames[1], constraint.last_frame or 0)
    if isinstance(constraint, RootPath):
        return None
    if isinstance(constraint, RootTrajectory):
        return constraint.first_frame, constraint.first_frame + len(constraint.positions_m) - 1
    return constraint.frame, constraint.frame
