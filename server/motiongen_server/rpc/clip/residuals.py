"""How far a clip is from what its constraints ask for: metres, and radians of heading and of rotation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import service_pb2
from motiongen_server.engine.types import (
    Constraint,
    Float32Array,
    JointTargets,
    Keyframe,
    RigLayout,
    RootTrajectory,
    Waypoint,
)
from motiongen_server.rpc.clip.kinematics import Float64, heading, posed

_GROUND = (0, 2)  # x and z


def constrained_frames(constraints: Iterable[Constraint]) -> frozenset[int]:
    """Every frame that a constraint asks something of."""
    return frozenset(
        frame for constraint in constraints for frame in range(constraint.first_frame, constraint.last_frame + 1)
    )


def residuals(
    rig: RigLayout, constraints: Sequence[Constraint], frames: Sequence[int], rows: Float32Array
) -> list[service_pb2.ConstraintResidual]:
    """The residual of each constraint, in order, each measured alone. rows: (K, row_width), those of `frames` (K)."""
    if not constraints:
        return []
    positions, rotations = posed(rig, rows)
    headings = heading(rig, positions, rotations)
    index = {frame: row for row, frame in enumerate(frames)}
    return [_residual(rig, constraint, index, positions, rotations, headings) for constraint in constraints]


def _residual(
    rig: RigLayout,
    constraint: Constraint,
    index: dict[int, int],
    positions: Float64,
    rotations: Float64,
    headings: Float64,
) -> service_pb2.ConstraintResidual:
    residual = service_pb2.ConstraintResidual(constraint_id=constraint.constraint_id)
    asked = range(constraint.first_frame, constraint.last_frame + 1)
    at = [index[frame] for frame in asked if frame in index]
    residual.frame_count = len(at)
    if not at:
        return residual
    match constraint:
        case Waypoint():
            goal = np.array([[constraint.x, constraint.z]])
            _note(residual.position_m, _distances(positions[at, 0][:, _GROUND], goal))
            if constraint.heading is not None:
                _note(residual.heading_rad, _turned(headings[at], np.array([constraint.heading])))
        case RootTrajectory():
            there = [frame - constraint.first_frame for frame in asked if frame in index]
            _note(residual.position_m, _distances(positions[at, 0][:, _GROUND], constraint.xz[there]))
            if constraint.heading is not None:
                _note(residual.heading_rad, _turned(headings[at], constraint.heading[there]))
        case JointTargets():
            joints = list(constraint.joints)
            _note(residual.position_m, _distances(positions[at[0], joints], constraint.positions))
            if constraint.rotations is not None and (turns := constraint.turns):
                turned = [joints[turn] for turn in turns]
                _note(residual.rotation_rad, _angles(rotations[at[0], turned], constraint.rotations[turns]))
        case Keyframe():
            _note(residual.position_m, _distances(positions[at[0]], constraint.positions))
            pose = constraint.positions[None].astype(np.float64)
            if rig.hip_joints is not None:  # else a pose of positions alone does not say where it faces
                _note(residual.heading_rad, _turned(headings[at], heading(rig, pose, rotations[at])))
    return residual


def _distances(found: Float64, asked: NDArray[np.floating]) -> Float64:
    distances: Float64 = np.linalg.norm(found - asked, axis=-1)
    return distances


def _turned(found: Float64, asked: NDArray[np.floating]) -> Float64:
    difference = found - asked
    return np.abs(np.arctan2(np.sin(difference), np.cos(difference)))


def _angles(found: Float64, asked: NDArray[np.floating]) -> Float64:
    """Angles between rotations (K, 3, 3), exact also where they are almost equal."""
    between = np.swapaxes(asked.astype(np.float64), -1, -2) @ found
    axis = np.stack(
        [between[:, 2, 1] - between[:, 1, 2], between[:, 0, 2] - between[:, 2, 0], between[:, 1, 0] - between[:, 0, 1]],
        axis=-1,
    )
    angles: Float64 = np.arctan2(np.linalg.norm(axis, axis=-1), np.trace(between, axis1=-2, axis2=-1) - 1)
    return angles


def _note(deviation: service_pb2.Deviation, errors: Float64) -> None:
    deviation.mean = float(errors.mean())
    deviation.worst = float(errors.max())
