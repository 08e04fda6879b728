"""Reads constraint lists in the JSON form that ARDY's and Kimodo's tools exchange, as constraints of a session or clip.

The file is a list of objects with `type` and `frame_indices`. A root2d has `root_2d` (x and z) and optionally
`global_root_heading`, as angles (K) or as cosine and sine (K, 2). The others have `local_joints_rot` (axis times
angle), `root_positions` and optionally `root_2d`. `smooth_root_2d` is read as `root_2d`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput
from motiongen_client.kinematics import axis_angle_to_quaternion, facing_rad, forward_kinematics, matrix_to_quaternion
from motiongen_client.motion import Rig
from motiongen_client.types import Constraint, JointTargets, Keyframe, RootTrajectory, Waypoint, as_array

LIMB_TYPES = {
    "left-hand": ("LeftHand", "Hips"),
    "right-hand": ("RightHand", "Hips"),
    "left-foot": ("LeftFoot", "Hips"),
    "right-foot": ("RightFoot", "Hips"),
}
TYPES = ("root2d", "fullbody", "end-effector", *LIMB_TYPES)
MAX_BYTES = 64 << 20
UNIT_WITHIN = 0.01
_MOST_QUOTED = 60


def read_constraints(path: Path | str, rig: Rig, num_frames: int, max_path_frames: int = 400) -> list[Constraint]:
    """The constraints of a file, for a clip of num_frames frames. Raises InvalidInput naming entry and field.

    max_path_frames: most frames of one RootTrajectory (Limits.max_trajectory_frames); longer ones are split.
    """
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise InvalidInput("constraint file", str(path), f"a file of at most {MAX_BYTES} bytes")
        entries = json.loads(Path(path).read_text(encoding="utf-8-sig"), object_pairs_hook=_unique)
    except InvalidInput:
        raise
    except OSError as error:
        raise InvalidInput("constraint file", str(path), f"a file that can be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:  # not text, not JSON, or a number with thousands of digits
        raise InvalidInput("constraint file", str(path), f"a JSON list of constraints: {error}") from None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InvalidInput("constraint file", str(path), "a JSON list of objects with type and frame_indices")
    found: list[Constraint] = []
    for index, fields in enumerate(entries):
        found += _Entry(f"constraint {index}", fields, rig, num_frames, max_path_frames).constraints()
    return found


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The fields of an object. Raises ValueError for one that is there twice: the first would have no effect."""
    fields: dict[str, Any] = {}
    for name, value in pairs:
        if name in fields:
            raise ValueError(f"an object has {name[:_MOST_QUOTED]!r} twice")
        fields[name] = value
    return fields


def _has_truth_value(values: object) -> bool:
    """Whether nested lists hold true or false, which numpy would read as 1 and 0."""
    return isinstance(values, bool) or (isinstance(values, list) and any(map(_has_truth_value, values)))


@dataclass(frozen=True)
class _Entry:
    """One object of the list. where: names it in errors."""

    where: str
    fields: Mapping[str, Any]
    rig: Rig
    num_frames: int
    max_path_frames: int

    def constraints(self) -> Iterator[Constraint]:
        kind = self.fields.get("type")
        if kind not in TYPES:
            raise InvalidInput(f"{self.where}, type", kind, f"one of {', '.join(TYPES)}")
        frames = self._frames()
        ground = self._ground(len(frames))
        if kind == "root2d":
            if ground is None:
                raise InvalidInput(f"{self.where}, root_2d", None, "x and z at each frame, metres")
            return self._paths(frames, ground, self._heading(len(frames)))
        positions, rotations = self._poses(len(frames), ground)
        if kind == "fullbody":
            return (Keyframe(frame, positions[row]) for row, frame in enumerate(frames))
        return self._limbs(frames, positions, rotations, LIMB_TYPES.get(kind) or self._names())

    def _frames(self) -> list[int]:
        frames = self.fields.get("frame_indices")
        allowed = f"a list of whole numbers from 0 to {self.num_frames - 1}"
        if not isinstance(frames, list):
            raise InvalidInput(f"{self.where}, frame_indices", frames, allowed)
        for frame in frames:
            if type(frame) is not int or not 0 <= frame < self.num_frames:
                raise InvalidInput(f"{self.where}, frame_indices", frame, allowed)
        return frames

    def _array(self, name: str, *shape: int) -> NDArray[np.float32]:
        if name not in self.fields:
            raise InvalidInput(f"{self.where}, {name}", None, f"numbers of shape {shape}")
        values = as_array(f"{self.where}, {name}", self.fields[name], shape)
        if _has_truth_value(self.fields[name]):
            raise InvalidInput(f"{self.where}, {name}", "true or false", f"numbers of shape {shape}")
        return values

    def _ground(self, count: int) -> NDArray[np.float32] | None:
        named = [name for name in ("root_2d", "smooth_root_2d") if self.fields.get(name) is not None]
        found = [self._array(name, count, 2) for name in named]
        if len(found) == 2 and not np.array_equal(found[0], found[1]):
            raise InvalidInput(f"{self.where}, smooth_root_2d", "not root_2d", "one of them: they name one thing")
        return found[0] if found else None

    def _heading(self, count: int) -> NDArray[np.float32] | None:
        name = "global_root_heading"
        given = self.fields.get(name)
        if given is None:
            return None
        if not (isinstance(given, list) and given and isinstance(given[0], list)):
            return self._array(name, count)
        pairs = self._array(name, count, 2)
        if np.abs(np.linalg.norm(pairs, axis=1) - 1).max() > UNIT_WITHIN:
            raise InvalidInput(f"{self.where}, {name}", "pairs not of length 1", "angles, or pairs (cosine, sine)")
        angles: NDArray[np.float32] = np.arctan2(pairs[:, 1], pairs[:, 0])
        return angles

    def _poses(self, count: int, ground: NDArray[np.float32] | None) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """World positions (K, J, 3) and rotations (K, J, 3, 3), with the root above `ground` if that is given."""
        local = axis_angle_to_quaternion(self._array("local_joints_rot", count, self.rig.num_joints, 3))
        root = self._array("root_positions", count, 3).astype(np.float64)
        if ground is not None:
            root[:, [0, 2]] = ground
        positions, rotations = forward_kinematics(self.rig.parents, self.rig.offsets_m, root, local)
        return positions.astype(np.float32), np.asarray(rotations, np.float64)

    def _names(self) -> tuple[str, ...]:
        names, known = self.fields.get("joint_names"), list(self.rig.limbs)
        if not isinstance(names, list) or not names or not all(name in known for name in names):
            raise InvalidInput(f"{self.where}, joint_names", names, f"one or more of {', '.join(known)}")
        return tuple(names)

    def _limbs(
        self,
        frames: list[int],
        positions: NDArray[np.float32],
        rotations: NDArray[np.float64],
        names: tuple[str, ...],
    ) -> Iterator[Constraint]:
        """Targets for limbs: the places of their joints, the rotation of the first, and the character's heading."""
        limbs, hips = self.rig.limbs, self.rig.hip_joints
        if hips is None or any(name not in limbs for name in names):
            raise InvalidInput(f"{self.where}, type", self.fields["type"], f"root2d or fullbody for {self.rig.rig_id}")
        joints = list(dict.fromkeys([0, *(joint for name in names for joint in limbs[name])]))
        turned = {limbs[name][0] for name in names}
        for row, frame in enumerate(frames):
            quaternions = matrix_to_quaternion(rotations[row, joints])
            quaternions[[joint not in turned for joint in joints]] = 0  # free
            yield JointTargets(frame, joints, positions[row, joints], quaternions)
            x, _, z = positions[row, 0].tolist()
            yield Waypoint(frame, x, z, float(facing_rad(positions[row], hips)))

    def _paths(
        self, frames: list[int], ground: NDArray[np.float32], headings: NDArray[np.float32] | None
    ) -> Iterator[Constraint]:
        """A trajectory for each run of consecutive frames."""
        begin = 0
        for end in range(1, len(frames) + 1):
            goes_on = end < len(frames) and frames[end] == frames[end - 1] + 1 and end - begin < self.max_path_frames
            if not goes_on:
                facing = None if headings is None else headings[begin:end]
                yield RootTrajectory(frames[begin], ground[begin:end], facing)
                begin = end
