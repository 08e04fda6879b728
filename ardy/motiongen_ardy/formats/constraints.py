"""Constraint lists in the JSON form that ARDY's and Kimodo's tools exchange.

A list of objects with `type` and `frame_indices`. A root2d has `root_2d` (x and z) and optionally
`global_root_heading`; the others have `local_joints_rot` (axis times angle), `root_positions` and optionally `root_2d`;
joint positions follow by kinematics. `smooth_root_2d` is read as `root_2d`, and headings as angles (K) or as cosine and
sine (K, 2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets, limb_chains
from motiongen_ardy.core.constraint_values import ConstraintError, require_frames
from motiongen_ardy.core.files import written_whole
from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.rotation import axis_angle_to_matrix, rotation_vector
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics
from motiongen_ardy.formats.bounded import MAX_FRAMES, MAX_JSON_BYTES, read_text
from motiongen_ardy.formats.errors import FormatError, shortened
from motiongen_ardy.formats.json_text import NumbersError, numbers, parse_json, write_json

LIMB_TYPES = {
    "left-hand": ("LeftHand", "Hips"),
    "right-hand": ("RightHand", "Hips"),
    "left-foot": ("LeftFoot", "Hips"),
    "right-foot": ("RightFoot", "Hips"),
}
TYPES = ("root2d", "fullbody", "end-effector", *LIMB_TYPES)
UNIT_WITHIN = 0.01
_MAX_FRAME = 2**31 - 1


@dataclass(frozen=True, eq=False)
class RootConstraint:
    """The root's ground position at frames (K).

    ground: (K, 2), x and z in metres; heading: (K) radians, or None.
    """

    frames: tuple[int, ...]
    ground: Tensor
    heading: Tensor | None = None


@dataclass(frozen=True, eq=False)
class PoseConstraint:
    """Whole poses at frames (K), or limbs of them.

    rotation_vectors: (K, J, 3), axis times angle, parent-relative; root_positions: (K, 3) metres; limbs: names from
    `limb_chains`, None for the whole body; ground: (K, 2), the root's ground position if not the pose's own.
    """

    frames: tuple[int, ...]
    rotation_vectors: Tensor
    root_positions: Tensor
    limbs: tuple[str, ...] | None = None
    ground: Tensor | None = None


Constraint = RootConstraint | PoseConstraint


def constraint_targets(skeleton: Skeleton, constraints: Sequence[Constraint]) -> Targets:
    """The targets of all constraints together; where two disagree, the later one wins.

    Raises ConstraintError for shapes that do not fit the skeleton and for limbs that it does not have.
    """
    targets = Targets(skeleton)
    for constraint in constraints:
        if isinstance(constraint, RootConstraint):
            targets.add_waypoints(constraint.frames, constraint.ground, constraint.heading)
            continue
        local = axis_angle_to_matrix(constraint.rotation_vectors)
        rotations, positions = forward_kinematics(skeleton, local, constraint.root_positions)
        if constraint.limbs is None:
            targets.add_keyframes(constraint.frames, positions, constraint.ground)
        else:
            targets.add_end_effectors(constraint.frames, constraint.limbs, positions, rotations, constraint.ground)
    return targets


def pose_constraint(motion: Motion, frames: Sequence[int], limbs: tuple[str, ...] | None = None) -> PoseConstraint:
    """The poses of a motion (T) at some of its frames, as a constraint.

    Raises ConstraintError for frames that the motion does not have.
    """
    rows = require_frames(frames)
    if any(row >= motion.num_frames for row in rows):
        raise ConstraintError(f"frames hold {max(rows)}; the motion has 0 to {motion.num_frames - 1}")
    return PoseConstraint(
        tuple(rows), rotation_vector(motion.local_rotations[rows]), motion.root_positions[rows], limbs
    )


def read_constraints(path: Path, skeleton: Skeleton, num_frames: int | None = None) -> list[Constraint]:
    """Read a constraint list. Raises FormatError as `parse_constraints` does, and OSError."""
    return parse_constraints(parse_json(read_text(path, MAX_JSON_BYTES), path), skeleton, path, num_frames)


def parse_constraints(
    content: object, skeleton: Skeleton, source: object = "constraints", num_frames: int | None = None
) -> list[Constraint]:
    """The constraints in parsed JSON, for a clip of num_frames frames (None: of any length).

    Raises FormatError naming the entry, the field, its value and what is allowed; unknown fields are ignored, because
    other tools add their own.
    """
    if not isinstance(content, list):
        raise FormatError(source, f"constraints are a {type(content).__name__}", "give a list of objects")
    constraints: list[Constraint] = []
    for index, fields in enumerate(content):
        where = f"{source}, constraint {index}"
        if not isinstance(fields, Mapping):
            given = f"it is a {type(fields).__name__}"
            raise FormatError(where, given, "give an object with type and frame_indices")
        constraint = _Entry(where, fields).constraint(skeleton, num_frames)
        try:
            constraint_targets(skeleton, [constraint])
        except ConstraintError as error:
            raise FormatError(where, str(error), f"the skeleton is {skeleton.name}") from None
        constraints.append(constraint)
    return constraints


def write_constraints(path: Path, constraints: Sequence[Constraint]) -> None:
    """Write a constraint list, one entry per line, with `root_2d` and headings as angles.

    Raises ValueError for NaN, and ConstraintError for frames that are not whole or are negative.
    """
    text = write_json([_written(constraint) for constraint in constraints])
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _written(constraint: Constraint) -> dict[str, Any]:
    frames = require_frames(constraint.frames)
    if isinstance(constraint, RootConstraint):
        entry = {"type": "root2d", "frame_indices": frames, "root_2d": constraint.ground.tolist()}
        if constraint.heading is not None:
            entry["global_root_heading"] = constraint.heading.tolist()
        return entry
    entry = {
        "type": "fullbody",
        "frame_indices": frames,
        "local_joints_rot": constraint.rotation_vectors.tolist(),
        "root_positions": constraint.root_positions.tolist(),
    }
    if constraint.limbs is not None:
        named = [kind for kind, limbs in LIMB_TYPES.items() if set(limbs) == set(constraint.limbs)]
        entry["type"] = named[0] if named else "end-effector"
        if not named:
            entry["joint_names"] = list(constraint.limbs)
    if constraint.ground is not None:
        entry["root_2d"] = constraint.ground.tolist()
    return entry


@dataclass(frozen=True)
class _Entry:
    """One object of the list; `where` names it in errors."""

    where: str
    fields: Mapping[str, Any]

    def constraint(self, skeleton: Skeleton, num_frames: int | None) -> Constraint:
        kind = self.fields.get("type")
        if not isinstance(kind, str) or kind not in TYPES:
            raise FormatError(self.where, f"type is {shortened(kind)}", f"it must be one of {', '.join(TYPES)}")
        frames = self.frames(num_frames)
        count = len(frames)
        ground = self.ground(count)
        if kind == "root2d":
            if ground is None:
                raise self.missing("root_2d")
            return RootConstraint(frames, ground, self.heading(count))
        rotations = self.tensor("local_joints_rot", (count, skeleton.num_joints, 3))
        root = self.tensor("root_positions", (count, 3))
        limbs = None if kind == "fullbody" else LIMB_TYPES.get(kind) or self.limbs(skeleton)
        return PoseConstraint(frames, rotations, root, limbs, ground)

    def missing(self, name: str) -> FormatError:
        there = ", ".join(shortened(field) for field in list(self.fields)[:20])
        return FormatError(self.where, f"{name} is missing", f"the entry has {there}")

    def tensor(self, name: str, shape: tuple[int, ...]) -> Tensor:
        if self.fields.get(name) is None:
            raise self.missing(name)
        try:
            values = torch.from_numpy(numbers(self.fields[name], shape)).float()
        except NumbersError as error:
            raise FormatError(self.where, f"{name} is {error}", f"its shape must be {shape}") from None
        if not values.isfinite().all():
            raise FormatError(self.where, f"{name} holds numbers beyond 3.4e38", "give metres and radians")
        return values

    def frames(self, num_frames: int | None) -> tuple[int, ...]:
        frames = self.fields.get("frame_indices")
        if frames is None:
            raise self.missing("frame_indices")
        end = _MAX_FRAME if num_frames is None else num_frames
        allowed = f"give whole numbers of 0 to {end - 1}, {MAX_FRAMES} at most"
        if not isinstance(frames, list) or len(frames) > MAX_FRAMES:
            raise FormatError(self.where, f"frame_indices is {shortened(frames)}", allowed)
        for frame in frames:
            if type(frame) is not int or not 0 <= frame < end:
                raise FormatError(self.where, f"frame_indices holds {shortened(frame)}", allowed)
        return tuple(frames)

    def ground(self, count: int) -> Tensor | None:
        names = [name for name in ("root_2d", "smooth_root_2d") if self.fields.get(name) is not None]
        found = [self.tensor(name, (count, 2)) for name in names]
        if len(found) == 2 and not torch.equal(*found):
            raise FormatError(self.where, "root_2d and smooth_root_2d differ", "they are two names of one thing")
        return found[0] if found else None

    def heading(self, count: int) -> Tensor | None:
        given = self.fields.get("global_root_heading")
        if given is None:
            return None
        if not (isinstance(given, list) and given and isinstance(given[0], list)):
            return self.tensor("global_root_heading", (count,))
        pairs = self.tensor("global_root_heading", (count, 2))
        worst = float((pairs.norm(dim=1) - 1).abs().max())
        if worst > UNIT_WITHIN:
            given = f"global_root_heading holds a pair that is {worst:.3g} off length 1"
            raise FormatError(self.where, given, "give angles in radians, or pairs (cosine, sine)")
        return torch.atan2(pairs[:, 1], pairs[:, 0])

    def limbs(self, skeleton: Skeleton) -> tuple[str, ...]:
        names = self.fields.get("joint_names")
        if names is None:
            raise self.missing("joint_names")
        known = limb_chains(skeleton)
        allowed = f"give a list of one or more of {', '.join(known)}"
        if not isinstance(names, list) or not names:
            raise FormatError(self.where, f"joint_names is {shortened(names)}", allowed)
        for name in names:
            if not isinstance(name, str) or name not in known:
                raise FormatError(self.where, f"joint_names holds {shortened(name)}", allowed)
        return tuple(dict.fromkeys(names))
