"""The targets of a take as the JSON list of constraints that ARDY's and Kimodo's tools exchange."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from motiongen_client.motion import Motion
from motiongen_client.types import HeadingTarget, JointRotations, JointTargets, Keyframe, RootTrajectory, Waypoint
from motiongen_tools.view.constraint_json import read_constraint
from motiongen_tools.view.script import Target


def write_constraint_list(targets: Iterable[Target], take: Motion) -> tuple[str, list[str]]:
    """The file's text, and what it has no words for. Frames are counted from the take's first.

    The list knows poses and limbs by rotations alone, which targets of joint positions do not have.
    """
    entries: list[dict[str, Any]] = []
    left_out: list[str] = []
    for target in targets:
        if target.is_removed:
            continue
        constraint = read_constraint(target.spec)
        match constraint:
            case Waypoint(frame=frame) if _is_within(frame, take):
                entry: dict[str, Any] = {"type": "root2d", "frame_indices": [frame - take.first_frame]}
                entry["root_2d"] = [[constraint.x_m, constraint.z_m]]
                if constraint.heading_rad is not None:
                    entry["global_root_heading"] = [constraint.heading_rad]
                entries.append(entry)
            case RootTrajectory(first_frame=first):
                inside = [n for n in range(len(constraint.positions_m)) if _is_within(first + n, take)]
                if inside:
                    entry = {"type": "root2d", "frame_indices": [first + n - take.first_frame for n in inside]}
                    entry["root_2d"] = [constraint.positions_m[n].tolist() for n in inside]
                    if constraint.headings_rad is not None:
                        entry["global_root_heading"] = [float(constraint.headings_rad[n]) for n in inside]
                    entries.append(entry)
            case Keyframe() | JointTargets() | HeadingTarget() | JointRotations():
                kind = target.spec["kind"]
                left_out.append(f"constraint {target.constraint_id}: the list has no words for this {kind}")
    return json.dumps(entries, indent=1) + "\n", left_out


def _is_within(frame: int, take: Motion) -> bool:
    return take.first_frame <= frame < take.first_frame + len(take)
