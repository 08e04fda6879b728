"""Constraint lists in the JSON form that ARDY's tools exchange.

A list of objects with `type` (root2d, fullbody, end-effector, left-hand, right-hand, left-foot, right-foot) and
`frame_indices`. root2d has `root_2d` (x and z; `smooth_root_2d` in older files) and optionally `global_root_heading`;
the others have `local_joints_rot` (axis times angle) and `root_positions`, from which kinematics gives the positions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from ardy.constraint import ConstraintError, Targets, require_numbers
from ardy.rotation import axis_angle_to_matrix
from ardy.skeleton import Skeleton, forward_kinematics

LIMB_TYPES = {
    "left-hand": ("LeftHand", "Hips"),
    "right-hand": ("RightHand", "Hips"),
    "left-foot": ("LeftFoot", "Hips"),
    "right-foot": ("RightFoot", "Hips"),
}
TYPES = ("root2d", "fullbody", "end-effector", *LIMB_TYPES)


def targets_from_json(skeleton: Skeleton, content: object) -> Targets:
    """The targets that a parsed constraint list asks for. Raises ConstraintError naming the entry and the field."""
    if not isinstance(content, list):
        raise ConstraintError(f"constraints are a {type(content).__name__}; give a list of objects")
    targets = Targets(skeleton)
    for index, entry in enumerate(content):
        where = f"constraint {index}"
        if not isinstance(entry, Mapping):
            raise ConstraintError(f"{where} is a {type(entry).__name__}; give an object with type and frame_indices")
        try:
            _add_entry(targets, entry)
        except ConstraintError as error:
            raise ConstraintError(f"{where}: {error}") from None
    return targets


def _add_entry(targets: Targets, entry: Mapping[str, Any]) -> None:
    kind = entry.get("type")
    if kind not in TYPES:
        raise ConstraintError(f"type is {kind!r}; it must be one of {', '.join(TYPES)}")
    frames = _frames(entry)
    ground_name = "root_2d" if "root_2d" in entry else "smooth_root_2d"
    if kind == "root2d":
        ground = _numbers(entry, ground_name if ground_name in entry else "root_2d", (len(frames), 2))
        heading = None
        if entry.get("global_root_heading") is not None:
            heading = _numbers(entry, "global_root_heading", (len(frames),))
        targets.add_root(frames, ground, heading)
        return
    joints = targets.skeleton.num_joints
    local = axis_angle_to_matrix(_numbers(entry, "local_joints_rot", (len(frames), joints, 3)))
    root = _numbers(entry, "root_positions", (len(frames), 3))
    rotations, positions = forward_kinematics(targets.skeleton, local, root)
    elsewhere = _numbers(entry, ground_name, (len(frames), 2)) if ground_name in entry else None
    if kind == "fullbody":
        targets.add_full_body(frames, positions, elsewhere)
        return
    targets.add_end_effectors(frames, LIMB_TYPES.get(kind) or _limbs(entry), positions, rotations, elsewhere)


def _field(entry: Mapping[str, Any], name: str) -> Any:
    if name not in entry:
        raise ConstraintError(f"{name} is missing; there are {', '.join(entry)}")
    return entry[name]


def _frames(entry: Mapping[str, Any]) -> list[int]:
    frames = _field(entry, "frame_indices")
    if not isinstance(frames, list) or not all(type(frame) is int and frame >= 0 for frame in frames):
        raise ConstraintError(f"frame_indices is {frames!r}; give a list of whole numbers from 0")
    return frames


def _limbs(entry: Mapping[str, Any]) -> tuple[str, ...]:
    names = _field(entry, "joint_names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ConstraintError(f"joint_names is {names!r}; give a list of names")
    return tuple(names)


def _numbers(entry: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Tensor:
    try:
        values = torch.tensor(_field(entry, name), dtype=torch.float32)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ConstraintError(f"{name} is not an array of numbers: {error}") from None
    require_numbers(name, values, shape)
    return values
