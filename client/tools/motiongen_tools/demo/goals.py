"""Goals of a character as numbers, and how near its motion came to them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from motiongen_client.motion import Motion
from motiongen_client.types import JointTargets, RootTrajectory, Waypoint
from motiongen_tools.poses import headings_rad

_STILL_MPS = 0.15  # a standing character sways
_SMOOTH_S = 0.5  # about the length of a step; the root sways with each


@dataclass(frozen=True)
class Facing:
    """Face a heading, radians, at a frame."""

    frame: int
    heading_rad: float


@dataclass(frozen=True)
class Pace:
    """Move over the ground at a velocity, metres a second, from first_frame up to end_frame - 1."""

    first_frame: int
    end_frame: int
    x_mps: float
    z_mps: float


Aim: TypeAlias = Waypoint | RootTrajectory | JointTargets | Facing | Pace


@dataclass(frozen=True, eq=False)
class Goal:
    """A goal. label: in words; asked_frame: the frame that was shown when it was asked for."""

    label: str
    asked_frame: int
    aim: Aim

    @property
    def frames(self) -> range:
        """The frames at which the goal is judged: all of a path, the second half of a velocity."""
        match self.aim:
            case RootTrajectory(first_frame=first, positions_m=positions):
                return range(first, first + len(positions))
            case Pace(first_frame=first, end_frame=end):
                return range((first + end) // 2, end)
            case _:
                return range(self.aim.frame, self.aim.frame + 1)

    @property
    def unit(self) -> str:
        return {Facing: "degrees", Pace: "m/s"}.get(type(self.aim), "cm")

    @property
    def is_place(self) -> bool:
        """Whether it is a waypoint, which the demo must reach."""
        return isinstance(self.aim, Waypoint)


@dataclass(frozen=True)
class Reached:
    """error: the mean over the frames at which a goal is judged, in its unit; reached_s: first time within bound."""

    error: float
    reached_s: float | None
    is_within: bool


def bound(goal: Goal, place_m: float) -> float:
    """Greatest allowed error in the goal's unit: place_m for places, paths, hands; 15 degrees; a tenth of a speed."""
    if isinstance(goal.aim, Pace):
        return max(0.1 * math.hypot(goal.aim.x_mps, goal.aim.z_mps), _STILL_MPS)
    return 15.0 if isinstance(goal.aim, Facing) else 100 * place_m


def measure(goal: Goal, motion: Motion, place_m: float) -> Reached | None:
    """How near a motion came to a goal; None if it ends before the goal is due."""
    if goal.frames.start < motion.first_frame or goal.frames.stop > motion.first_frame + len(motion):
        return None
    errors, allowed = errors_over_time(goal, motion), bound(goal, place_m)
    error = float(errors[goal.frames.start - motion.first_frame : goal.frames.stop - motion.first_frame].mean())
    asked = max(goal.asked_frame - motion.first_frame, 0)
    within = asked + np.flatnonzero(errors[asked:] <= allowed)
    reached_s = (motion.first_frame + int(within[0])) / motion.rig.frame_rate_hz if len(within) else None
    return Reached(error, reached_s, error <= allowed)


def errors_over_time(goal: Goal, motion: Motion) -> NDArray[np.float64]:
    """(T,) distance from the goal at each frame, in its unit; for a path, from its place at the nearest frame."""
    root = motion.root_translation_m[:, [0, 2]].astype(np.float64)
    match goal.aim:
        case Waypoint(x_m=x, z_m=z):
            return 100 * np.hypot(root[:, 0] - x, root[:, 1] - z)
        case RootTrajectory(first_frame=first, positions_m=positions):
            rows = np.clip(np.arange(len(root)) + motion.first_frame - first, 0, len(positions) - 1)
            return 100 * np.asarray(np.linalg.norm(root - positions[rows], axis=1))
        case JointTargets(joints=joints, positions_m=positions):
            moved = (
                motion.joint_positions_m()[:, joints[1:]].astype(np.float64) - positions[1:]
            )  # the root, which comes first, is not a target
            return 100 * np.asarray(np.linalg.norm(moved, axis=2).max(axis=1))
        case Facing(heading_rad=heading):
            turned = headings_rad(motion) - heading
            return np.asarray(np.degrees(np.abs((turned + math.pi) % (2 * math.pi) - math.pi)))
        case Pace(x_mps=x, z_mps=z):
            return np.asarray(np.linalg.norm(velocities_mps(motion) - (x, z), axis=1))


def velocities_mps(motion: Motion) -> NDArray[np.float64]:
    """(T, 2) velocity of the root over the ground, from a quarter of a second before to a quarter after each frame."""
    root = motion.root_translation_m[:, [0, 2]].astype(np.float64)
    half = max(motion.rig.frames_in(_SMOOTH_S / 2), 1)
    index = np.arange(len(root))
    after, before = np.minimum(index + half, len(root) - 1), np.maximum(index - half, 0)
    spans_s = np.maximum(after - before, 1) / motion.rig.frame_rate_hz
    return np.asarray((root[after] - root[before]) / spans_s[:, None])
