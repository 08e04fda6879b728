"""Constraints as a browser and a session file write them, and back.

An object with `kind` and the fields of the client's class of that kind, lists in place of arrays:

| kind | fields |
|---|---|
| waypoint | frame, x_m, z_m, heading_rad |
| trajectory | first_frame, positions_m, headings_rad |
| keyframe | frame, positions_m |
| joint_targets | frame, joints, positions_m, rotations_quat_wxyz |
| heading | frame, heading_rad |
| joint_rotations | frame, joints, rotations_quat_wxyz |

All may have tolerance_m and tolerance_rad.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from motiongen_client.errors import InvalidInput
from motiongen_client.types import (
    Constraint,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RootTrajectory,
    Waypoint,
)
from motiongen_tools.view.fields import Message

KINDS: dict[str, type[Constraint]] = {
    "waypoint": Waypoint,
    "trajectory": RootTrajectory,
    "keyframe": Keyframe,
    "joint_targets": JointTargets,
    "heading": HeadingTarget,
    "joint_rotations": JointRotations,
}
_NAMES = {kind: name for name, kind in KINDS.items()}


def read_constraint(message: Message) -> Constraint:
    """The constraint that an object describes. Raises InvalidInput naming the field."""
    given = dict(message)
    kind = KINDS.get(str(given.pop("kind", None)))
    if kind is None:
        raise InvalidInput("kind", message.get("kind"), f"one of {', '.join(KINDS)}")
    known = [field.name for field in fields(kind)]
    for name in given:
        if name not in known:
            raise InvalidInput(name, given[name], f"only {', '.join(known)} beside kind")
    try:
        return kind(**given)
    except (TypeError, ValueError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(_NAMES[kind], message, f"the fields {', '.join(known)}") from error


def write_constraint(constraint: Constraint) -> dict[str, Any]:
    """The object that `read_constraint` makes the same constraint of."""
    written: dict[str, Any] = {"kind": _NAMES[type(constraint)]}
    for field in fields(constraint):
        value = getattr(constraint, field.name)
        if isinstance(value, np.ndarray):
            value = value.tolist()
        elif isinstance(value, tuple):
            value = list(value)
        if value is not None:
            written[field.name] = value
    return written


def frames_of(constraint: Constraint) -> tuple[int, int]:
    """Its first and its last frame."""
    if isinstance(constraint, RootTrajectory):
        return constraint.first_frame, constraint.first_frame + len(constraint.positions_m) - 1
    return constraint.frame, constraint.frame
