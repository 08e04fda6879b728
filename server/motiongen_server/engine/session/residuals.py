"""Residuals: how far frames are from what a constraint asks: metres, and radians of heading and of rotation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.session.kinematics import Float64, Posed, heading_across
from motiongen_server.engine.types import (
    Constraint,
    Deviation,
    Float32Array,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RootTrajectory,
    Tolerance,
    Waypoint,
)

_GROUND = (0, 2)  # x and z
_LIFTED_EXCESS = 1e-3  # just not met, so that frames with larger errors rank behind it


@dataclass(slots=True)
class Residual:
    """The errors of one constraint, accumulated over the frames measured so far.

    Each list has one array per call of `add`: positions in metres, of the root (on the ground if no height is asked
    for) and of joints; headings and rotations in radians, 0 to pi. Empty: nothing of that kind is asked for. lifted:
    the frames at which a foot that should be on the ground is not.
    """

    num_frames: int = 0
    positions: list[Float64] = field(default_factory=list)
    headings: list[Float64] = field(default_factory=list)
    rotations: list[Float64] = field(default_factory=list)
    lifted: list[NDArray[np.bool_]] = field(default_factory=list)

    def add(self, constraint: Constraint, first_frame: int, posed: Posed) -> None:
        """Measure the frames from first_frame on; the constraint must apply to all of them."""
        self.num_frames += len(posed)
        match constraint:
            case Waypoint():
                goal = np.array([[constraint.x, constraint.z]])
                self._off_ground(posed, goal)
                if constraint.heading is not None:
                    self.headings.append(_turned(posed.heading(), np.array([constraint.heading])))
            case RootTrajectory():
                there = slice(first_frame - constraint.first_frame, first_frame - constraint.first_frame + len(posed))
                self._off_ground(posed, constraint.xz[there])
                if constraint.heading is not None:
                    self.headings.append(_turned(posed.heading(), constraint.heading[there]))
            case JointTargets():
                self._off_points(posed, constraint.joints, constraint.positions)
                if constraint.rotations is not None and (turns := constraint.turns):
                    turned = tuple(constraint.joints[turn] for turn in turns)
                    self._off_rotations(posed, turned, constraint.rotations[turns])
                if constraint.contacts:
                    self.lifted.append(posed.contacts()[:, constraint.contacts].max(axis=1) <= 0.5)
            case JointRotations():
                self._off_rotations(posed, constraint.joints, constraint.rotations)
            case HeadingTarget():
                self.headings.append(_turned(posed.heading(), np.array([constraint.heading])))
            case Keyframe():
                rig = posed.rig
                joints = tuple(range(len(rig.joint_names)))
                self._off_points(posed, joints, constraint.positions)
                if rig.hip_joints is not None:  # without hips, positions alone give no heading
                    right, left = constraint.positions[list(rig.hip_joints)].astype(np.float64)
                    self.headings.append(_turned(posed.heading(), heading_across(right, left)))

    def _off_ground(self, posed: Posed, goal: NDArray[np.floating]) -> None:
        self.positions.append(np.linalg.norm(posed.root()[:, _GROUND] - goal, axis=-1))

    def _off_points(self, posed: Posed, joints: tuple[int, ...], goals: Float32Array) -> None:
        found = posed.joints()[0][:, joints]
        self.positions.append(np.linalg.norm(found - goals, axis=-1))

    def _off_rotations(self, posed: Posed, joints: tuple[int, ...], goals: Float32Array) -> None:
        found = posed.joints()[1][:, joints]
        self.rotations.append(_angles(found, goals))

    def at(self, index: int) -> Residual:
        """The errors of one frame, for a residual with a single call of `add`."""
        here = slice(index, index + 1)
        kinds = (self.positions, self.headings, self.rotations)
        positions, headings, rotations = ([each[here] for each in kind] for kind in kinds)
        return Residual(1, positions, headings, rotations, [each[here] for each in self.lifted])

    def is_within(self, tolerance: Tolerance) -> bool:
        """Whether every error is within the tolerance of its kind."""
        return not any(each.any() for each in self.lifted) and all(
            deviation is None or deviation.worst <= most
            for deviation, most in (
                (self.position_m, tolerance.position_m),
                (self.heading_rad, tolerance.angle_rad),
                (self.rotation_rad, tolerance.angle_rad),
            )
        )

    @property
    def position_m(self) -> Deviation | None:
        return _deviation(self.positions)

    @property
    def heading_rad(self) -> Deviation | None:
        return _deviation(self.headings)

    @property
    def rotation_rad(self) -> Deviation | None:
        return _deviation(self.rotations)


@dataclass(frozen=True, slots=True)
class Nearest:
    """The frame that comes nearest to a constraint. excess: its worst error in tolerances; up to 1 is met."""

    frame: int
    excess: float
    residual: Residual


def nearest_frame(constraint: Constraint, first_frame: int, posed: Posed) -> Nearest:
    """The frame that comes nearest to a constraint among those from first_frame on, of which there must be one."""
    every, tolerance = Residual(), constraint.tolerance
    every.add(constraint, first_frame, posed)
    excess = np.zeros(len(posed))
    for errors, most in (
        (every.positions, tolerance.position_m),
        (every.headings, tolerance.angle_rad),
        (every.rotations, tolerance.angle_rad),
    ):
        for each in errors:
            worst = each.reshape(len(each), -1).max(axis=1)
            excess = np.maximum(excess, _excess(worst, np.float64(most)))
    for lifted in every.lifted:
        excess = np.where(lifted, np.maximum(excess, 1.0) + _LIFTED_EXCESS, excess)
    best = int(excess.argmin())
    return Nearest(first_frame + best, float(excess[best]), every.at(best))


def nearest_by_waypoint(waypoints: Sequence[Waypoint], first_frame: int, posed: Posed) -> list[Nearest]:
    """`nearest_frame` for several waypoints without heading, each with a frame among those from first_frame on.

    All are measured together: one by one, two hundred would take longer than a frame lasts.
    """
    goals = np.array([(each.x, each.z) for each in waypoints])
    errors = np.linalg.norm(posed.root()[:, _GROUND] - goals[:, None], axis=-1)  # (N, T)
    excess = _excess(errors, np.array([[each.tolerance.position_m] for each in waypoints]))
    frames = np.arange(first_frame, first_frame + len(posed))
    ends = np.array([(each.first_frame, each.last_frame) for each in waypoints])
    excess[(frames < ends[:, :1]) | (frames > ends[:, 1:])] = np.inf
    return [
        Nearest(first_frame + best, float(row[best]), Residual(1, [off[best : best + 1].copy()]))
        for best, row, off in zip(excess.argmin(axis=1).tolist(), excess, errors, strict=True)
    ]


def _excess(errors: Float64, most: np.float64 | Float64) -> Float64:
    """Errors in tolerances. With a tolerance of 0, only an error of 0 counts as met."""
    return np.where(errors <= most, errors / np.maximum(most, 1e-9), 1.0 + errors - most)


def _turned(found: Float64, asked: NDArray[np.floating]) -> Float64:
    difference = found - asked
    return np.abs(np.arctan2(np.sin(difference), np.cos(difference)))


def _angles(found: Float64, asked: NDArray[np.floating]) -> Float64:
    """Angles between rotations (..., 3, 3), exact even if these are almost equal."""
    between = np.swapaxes(asked.astype(np.float64), -1, -2) @ found
    axis = np.stack(
        [
            between[..., 2, 1] - between[..., 1, 2],
            between[..., 0, 2] - between[..., 2, 0],
            between[..., 1, 0] - between[..., 0, 1],
        ],
        axis=-1,
    )
    angles: Float64 = np.arctan2(np.linalg.norm(axis, axis=-1), np.trace(between, axis1=-2, axis2=-1) - 1)
    return angles


def _deviation(errors: list[Float64]) -> Deviation | None:
    if not errors:
        return None
    every = np.concatenate([each.ravel() for each in errors])
    return Deviation(float(every.mean()), float(every.max()))
