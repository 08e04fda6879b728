"""Placing: turns constraints "from here" or "as soon as possible" into ones with frames and world coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motiongen_ardy.locomotion.velocity import RootState
from motiongen_ardy.locomotion.way import WayTooLong, walked, walking_s
from motiongen_server.engine.types import (
    Code,
    Constraint,
    EventRefused,
    Float32Array,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Placement,
    RigLayout,
    RootPath,
    RootTrajectory,
    Span,
    StartPose,
    Unplaced,
    Waypoint,
)

LATE_S = 2.0
"""How long after the time at which a person would be there a place "as soon as possible" may still be reached."""
MOST_FRAME = 1 << 53
"""The largest frame number that doubles, and so the numbers of some languages, represent exactly."""
MOST_PATH_S = 600.0
"""The longest time to walk along one path."""
REACH = 0.25
"""How far a joint reaches over the ground without a step, as a share of the length of its chain from the root."""


@dataclass(frozen=True, slots=True)
class Anchor:
    """When a constraint takes effect, and the root's state just before.

    last_frame: the last that will ever be made, None if there is no end.
    """

    frame: int
    root: RootState
    fps: int
    rig: RigLayout
    last_frame: int | None = None

    def is_of(self, placement: Placement) -> bool:
        """Whether a constraint was placed from here."""
        root = self.root
        here = self.frame, root.x, root.z, root.heading
        return here == (placement.anchor_frame, placement.x, placement.z, placement.heading)

    def first_possible(self, x: float, z: float, heading: float | None) -> int:
        """The frame at which a walking person can be at a place, with a heading if one is given."""
        frame = self.frame + math.ceil(self.fps * walking_s(self.root, (x, z), heading)) - 1
        return frame if self.last_frame is None else min(frame, self.last_frame)


def placed(asked: Unplaced, anchor: Anchor, field: str) -> tuple[Constraint, Placement]:
    """The constraint in absolute frames and world coordinates, and its placement. field: its path in the event.

    Raises EventRefused for a path that takes too long to walk, and for frame numbers that are too large.
    """
    target = moved(asked.target, anchor.root) if asked.is_relative else asked.target
    if isinstance(target, RootPath):
        found: Constraint = _walked_path(target, anchor, field)
        return found, _placement(found, found.last_frame, anchor)
    start = anchor.frame if asked.frames_from_effect else 0
    if (last := start + max(target.last_frame, asked.last_frame or 0)) > MOST_FRAME:
        given, allowed = f"its last frame would be {last}", f"frames up to {MOST_FRAME} of the session"
        raise EventRefused(Code.INVALID_ARGUMENT, "FRAME_OUT_OF_RANGE", given, f"{field}.frame", allowed)
    if isinstance(target, RootTrajectory):
        found = replace(target, first_frame=target.first_frame + start)
        return found, _placement(found, found.last_frame, anchor)
    first = anchor.frame if asked.at_any_frame else target.frame + start
    soonest = anchor.first_possible(*goal_of(target, anchor.root, anchor.rig))
    if asked.at_any_frame:
        last = soonest + math.ceil(LATE_S * anchor.fps)
        span = Span(first, last if anchor.last_frame is None else min(last, anchor.last_frame), is_led=True)
        found = replace(target, frame=soonest, span=span)
    elif asked.last_frame is not None:
        last = asked.last_frame + start
        found = replace(target, frame=max(first, min(soonest, last)), span=Span(first, last))
    else:
        found = replace(target, frame=first)
    return found, _placement(found, found.frame, anchor)


def _placement(found: Constraint, arrival_frame: int, anchor: Anchor) -> Placement:
    root, first, last = anchor.root, found.first_frame, found.last_frame
    return Placement(
        found.constraint_id, first, last, arrival_frame, anchor.frame, float(root.x), float(root.z), float(root.heading)
    )


def goal_of(target: Constraint, root: RootState, rig: RigLayout) -> tuple[float, float, float | None]:
    """Where a constraint asks the root to go and to face; where it is now, if the constraint asks for no place."""
    match target:
        case Waypoint():
            return target.x, target.z, target.heading
        case HeadingTarget():
            return root.x, root.z, target.heading
        case Keyframe():
            return float(target.positions[0, 0]), float(target.positions[0, 2]), None
        case JointTargets():
            return (*root_for(target, root.x, root.z, rig), None)
        case _:
            return root.x, root.z, None


def root_for(target: JointTargets, x: float, z: float, rig: RigLayout) -> tuple[float, float]:
    """Where the root must be for joints to reach their places: as asked, or as near x, z as they allow."""
    if 0 in target.joints:
        root = target.positions[target.joints.index(0)]
        return float(root[0]), float(root[2])
    middle = target.positions[:, [0, 2]].mean(axis=0, dtype=np.float64)
    away = np.array([x, z]) - middle
    distance = float(np.hypot(*away))
    reach = REACH * min(_chain_m(joint, rig) for joint in target.joints)
    if distance <= reach:
        return x, z
    near = middle + away * (reach / distance)
    return float(near[0]), float(near[1])


def _chain_m(joint: int, rig: RigLayout) -> float:
    """The length of the bones from the root to a joint."""
    length = 0.0
    while joint > 0:
        length += float(np.linalg.norm(rig.neutral_offsets[joint]))
        joint = rig.parents[joint]
    return length


def _walked_path(path: RootPath, anchor: Anchor, field: str) -> RootTrajectory:
    places = np.concatenate([[[anchor.root.x, anchor.root.z]], path.corners])
    try:
        # First the time at full speed all the way, which is cheap to compute.
        if (seconds := float(np.hypot(*np.diff(places, axis=0).T).sum()) / path.speed_mps) > MOST_PATH_S:
            raise WayTooLong(seconds)
        ground = walked(path.corners, path.speed_mps, path.smoothing_m, anchor.root, anchor.fps, MOST_PATH_S)
    except WayTooLong as error:
        given = f"it takes {error.seconds:.0f} s to walk it at {path.speed_mps:g} m/s, slower in bends"
        allowed = f"a path of up to {MOST_PATH_S:g} s; send the rest when this one nears its end"
        raise EventRefused(Code.INVALID_ARGUMENT, "PATH_TOO_LONG", given, f"{field}.root_path", allowed) from error
    if anchor.last_frame is not None:
        ground = ground[: max(1, anchor.last_frame + 1 - anchor.frame)]
    return RootTrajectory(
        path.constraint_id, anchor.frame, ground.astype(np.float32), None, path.tolerance, path.weight
    )


def moved(target: Constraint | RootPath, seen_from: RootState | StartPose) -> Constraint | RootPath:
    """A target relative to a root, in world coordinates. Heights stay."""
    x, z, heading = seen_from.x, seen_from.z, seen_from.heading
    cos, sin = math.cos(heading), math.sin(heading)
    turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    here = np.array([x, 0.0, z])

    def points(positions: Float32Array) -> Float32Array:
        return _float32(positions @ turn.T + here)

    def ground(positions: Float32Array) -> Float32Array:
        return _float32(positions @ turn[np.ix_([0, 2], [0, 2])].T + here[[0, 2]])

    match target:
        case Waypoint():
            to_x, to_z = ground(np.array([[target.x, target.z]], np.float32))[0]
            facing = None if target.heading is None else target.heading + heading
            return replace(target, x=float(to_x), z=float(to_z), heading=facing)
        case HeadingTarget():
            return replace(target, heading=target.heading + heading)
        case RootTrajectory():
            facings = None if target.heading is None else _float32(target.heading + heading)
            return replace(target, xz=ground(target.xz), heading=facings)
        case RootPath():
            return replace(target, corners=ground(target.corners))
        case Keyframe():
            return replace(target, positions=points(target.positions))
        case JointRotations():
            return replace(target, rotations=_float32(turn @ target.rotations))
        case JointTargets():
            rotations = None if target.rotations is None else _float32(turn @ target.rotations)
            return replace(target, positions=points(target.positions), rotations=rotations)


def _float32(values: NDArray[np.floating]) -> Float32Array:
    return np.asarray(values, np.float32)
