"""The targets of a take in the JSON constraint list that ARDY's and Kimodo's tools exchange, and back."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from motiongen_client.kinematics import quaternion_to_matrix
from motiongen_client.motion import Motion, Rig
from motiongen_client.types import (
    FootContact,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RootPath,
    RootTrajectory,
    Waypoint,
)
from motiongen_tools.constraint_file import read_constraints
from motiongen_tools.view.constraint_json import write_constraint
from motiongen_tools.view.motion_files import FOLDER_PREFIX
from motiongen_tools.view.pose_fit import Float64, axis_angles, fitted, pose, reached, to_local
from motiongen_tools.view.script import Target
from motiongen_tools.view.settled import settled

MOST_FRAMES = 20_000
Entry = dict[str, Any]


def write_constraint_list(targets: Iterable[Target], take: Motion) -> tuple[str, list[str]]:
    """The text of the file, and notes on what it leaves out or adds. Frames count from the take's first.

    The list can describe keyframes and limbs only by the rotations of a whole pose. For a keyframe, these are fitted to
    its places; for a limb, they are the take's at that frame, with the limb bent to its target.
    """
    entries: list[Entry] = []
    told: list[str] = []
    for target in targets:
        if target.is_removed:
            continue
        try:
            entry, beside = _entry(target, take)
        except _Unsaid as why:
            told.append(f"constraint {target.constraint_id}, {target.spec['kind']}: {why}")
            continue
        entries.append(entry)
        if beside:
            told.append(f"constraint {target.constraint_id}, {target.spec['kind']}: {beside}")
    return json.dumps(entries, indent=1) + "\n", told


def read_list(data: bytes, rig: Rig, max_path_frames: int) -> list[Entry]:
    """The constraints of such a list, as messages. Raises InvalidInput."""
    with tempfile.TemporaryDirectory(prefix=FOLDER_PREFIX) as folder:
        path = Path(folder) / "constraints.json"
        path.write_bytes(data)
        found = read_constraints(path, rig, MOST_FRAMES, max_path_frames)
    return [write_constraint(constraint) for constraint in found]


def moved(specs: Iterable[Entry], frames: int) -> list[Entry]:
    """The same constraints, `frames` frames later."""
    return [
        {name: value + frames if name in ("frame", "first_frame") else value for name, value in spec.items()}
        for spec in specs
    ]


class _Unsaid(Exception):
    """The list cannot express a target; the message says why."""


def _entry(target: Target, take: Motion) -> tuple[Entry, str]:
    wanted = settled(target)
    match wanted:
        case None:
            raise _Unsaid("the server has not placed it yet")
        case Waypoint(frame=frame, x_m=x, z_m=z, heading_rad=heading):
            return _ground([_row(frame, take)], [[x, z]], None if heading is None else [heading]), ""
        case RootTrajectory(first_frame=first, positions_m=places, headings_rad=headings):
            inside = [n for n in range(len(places)) if 0 <= first + n - take.first_frame < len(take)]
            if not inside:
                raise _Unsaid("none of its frames is in the take")
            facing = None if headings is None else [float(headings[n]) for n in inside]
            return _ground([first + n - take.first_frame for n in inside], places[inside].tolist(), facing), ""
        case RootPath():
            if target.placement is None:
                raise _Unsaid("the server has not placed it yet")
            first = max(target.placement.first_frame - take.first_frame, 0)
            rows = list(range(first, min(target.placement.last_frame - take.first_frame + 1, len(take))))
            if not rows:
                raise _Unsaid("none of its frames is in the take")
            return _ground(rows, take.root_translation_m[rows][:, [0, 2]].tolist()), "written as it was walked"
        case HeadingTarget(frame=frame, heading_rad=heading):
            row = _row(frame, take)
            x, _, z = take.root_translation_m[row].tolist()
            return _ground([row], [[x, z]], [heading]), "written with the place that it has in the take"
        case Keyframe(frame=frame, positions_m=places):
            row, where = _row(frame, take), places.astype(np.float64)
            local = to_local(take.rig, fitted(take.rig, where, _pose_of(take, row)[1]))
            return _whole("fullbody", row, local, where[0]), ""
        case JointTargets(frame=frame):
            return _limbs(wanted, _row(frame, take), take)
        case FootContact():
            raise _Unsaid("lists of ARDY have no foot contacts")
        case JointRotations(frame=frame):
            return _rotated(wanted, _row(frame, take), take)


def _limbs(wanted: JointTargets, row: int, take: Motion) -> tuple[Entry, str]:
    rig = take.rig
    names = [_limb_of(rig, joint) for joint in wanted.joints if joint] or ["Hips"]
    root = take.root_translation_m[row].astype(np.float64)
    asked = dict(zip(wanted.joints, wanted.positions_m.astype(np.float64), strict=True))
    root = asked.get(0, root)
    local = _local_of(take, row)
    for joint, place in asked.items():
        if joint:
            local = reached(rig, root, local, joint, place)
    entry = _whole("end-effector", row, local, root)
    entry["joint_names"] = list(dict.fromkeys(names))
    return entry, "written with the pose of the take for its root, its heading and the limb's other joints"


def _rotated(wanted: JointRotations, row: int, take: Motion) -> tuple[Entry, str]:
    rig, local = take.rig, _local_of(take, row)
    names = []
    for joint, rotation in zip(wanted.joints, wanted.rotations_quat_wxyz, strict=True):
        name = _limb_of(rig, joint)
        if rig.limbs[name][0] != joint:
            raise _Unsaid(f"the list only rotates first joints of limbs, and {rig.joint_names[joint]} is not one")
        names.append(name)
        _, rotations = pose(rig, np.zeros(3), local)
        parent = np.eye(3) if rig.parents[joint] < 0 else rotations[rig.parents[joint]]
        local[joint] = parent.T @ quaternion_to_matrix(rotation.astype(np.float64))
    entry = _whole("end-effector", row, local, take.root_translation_m[row].astype(np.float64))
    entry["joint_names"] = names
    return entry, "written with the places of the take"


def _limb_of(rig: Rig, joint: int) -> str:
    for name, joints in rig.limbs.items():
        if joint in joints:
            return name
    raise _Unsaid(f"{rig.joint_names[joint]} belongs to no limb that the list names ({', '.join(rig.limbs) or 'none'})")


def _row(frame: int, take: Motion) -> int:
    if not take.first_frame <= frame < take.first_frame + len(take):
        raise _Unsaid(f"its frame {frame} is not in the take")
    return frame - take.first_frame


def _local_of(take: Motion, row: int) -> Float64:
    return np.asarray(quaternion_to_matrix(take.joint_rotation_quat_wxyz[row].astype(np.float64)))


def _pose_of(take: Motion, row: int) -> tuple[Float64, Float64]:
    return pose(take.rig, take.root_translation_m[row].astype(np.float64), _local_of(take, row))


def _ground(rows: list[int], places: Any, headings: list[float] | None = None) -> Entry:
    entry: Entry = {"type": "root2d", "frame_indices": rows, "root_2d": places}
    if headings is not None:
        entry["global_root_heading"] = headings
    return entry


def _whole(kind: str, row: int, local: Float64, root_m: Float64) -> Entry:
    turns = axis_angles(local).round(6).tolist()
    return {"type": kind, "frame_indices": [row], "local_joints_rot": [turns], "root_positions": [root_m.tolist()]}
