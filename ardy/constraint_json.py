"""Constraint lists in the JSON form that ARDY's tools exchange.

A list of objects with `type` (root2d, fullbody, end-effector, left-hand, right-hand, left-foot, right-foot) and
`frame_indices`. Positions are recomputed from rotations by forward kinematics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from ardy.constraint import ConstraintError, Targets
from ardy.rotation import axis_angle_to_matrix
from ardy.skeleton import Skeleton, forward_kinematics

LIMB_TYPES = {
    "left-hand": ("LeftHand", "Hips"),
    "right-hand": ("RightHand", "Hips"),
    "left-foot": ("LeftFoot", "Hips"),
    "right-foot": ("RightFoot", "Hips"),
}
TYPES = ("root2d", "fullbody", "end-effector", *LIMB_TYPES)


def targets_from_json(skeleton: Skeleton, entries: Sequence[Mapping[str, Any]]) -> Targets:
    """The targets that a parsed constraint list asks for. Raises ConstraintError naming the entry and the field."""
    targets = Targets(skeleton)
    for index, entry in enumerate(entries):
        where = f"constraint {index}"
        kind = entry.get("type")
        if kind not in TYPES:
            raise ConstraintError(f"{where} has type {kind!r}; known types are {', '.join(TYPES)}")
        frames = [int(frame) for frame in _field(entry, "frame_indices", where)]
        ground = _ground(entry, len(frames), where)
        if kind == "root2d":
            if ground is None:
                raise ConstraintError(f"{where} lacks root_2d, the ground positions [frames][2]")
            # Some writers list more positions than frames; those past the last frame name nothing.
            targets.add_root(frames, ground[: len(frames)], _heading(entry, len(frames), where))
            continue
        local = axis_angle_to_matrix(_tensor(entry, "local_joints_rot", (len(frames), skeleton.num_joints, 3), where))
        root = _tensor(entry, "root_positions", (len(frames), 3), where)
        rotations, positions = forward_kinematics(skeleton, local, root)
        if kind == "fullbody":
            targets.add_full_body(frames, positions, ground)
        else:
            limbs = LIMB_TYPES.get(kind) or tuple(_field(entry, "joint_names", where))
            targets.add_end_effectors(frames, limbs, positions, rotations, ground)
    return targets


def _field(entry: Mapping[str, Any], name: str, where: str) -> Any:
    if name not in entry:
        raise ConstraintError(f"{where} lacks {name}; it has {', '.join(entry)}")
    return entry[name]


def _tensor(entry: Mapping[str, Any], name: str, shape: tuple[int, ...], where: str) -> Tensor:
    try:
        value = torch.tensor(_field(entry, name, where), dtype=torch.float32)
    except (TypeError, ValueError) as error:
        raise ConstraintError(f"{where}.{name} is not an array of numbers: {error}") from error
    if value.shape != shape or not value.isfinite().all():
        raise ConstraintError(f"{where}.{name} has shape {tuple(value.shape)}; it must be {shape} finite numbers")
    return value


def _ground(entry: Mapping[str, Any], count: int, where: str) -> Tensor | None:
    for name in ("root_2d", "smooth_root_2d"):
        if name in entry:
            return _tensor(entry, name, (len(entry[name]), 2), where)
    return None


def _heading(entry: Mapping[str, Any], count: int, where: str) -> Tensor | None:
    """Headings as angles [K], or as (cos, sin) pairs [K][2] as some writers have them."""
    if entry.get("global_root_heading") is None:
        return None
    given = torch.tensor(entry["global_root_heading"], dtype=torch.float32)
    if given.shape == (count, 2):
        return torch.atan2(given[:, 1], given[:, 0])
    return _tensor(entry, "global_root_heading", (count,), where)
