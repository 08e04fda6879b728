"""Converts a job's constraints to motiongen_ardy's targets."""

from __future__ import annotations

import numpy as np

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_server.engine.types import (
    VELOCITY_ID,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RootTrajectory,
    Waypoint,
    WindowJob,
)


def job_targets(skeleton: Skeleton, job: WindowJob, stride_frames: int = 1) -> Targets | None:
    """The job's constraints as targets, None if it has none.

    stride_frames: a velocity's path asks for one frame in this many; in between the root may sway.
    """
    if not job.constraints:
        return None
    targets = Targets(skeleton)
    for constraint in job.constraints:
        if isinstance(constraint, Waypoint):
            heading = None if constraint.heading is None else np.array([constraint.heading], np.float32)
            targets.add_waypoints([constraint.frame], np.array([[constraint.x, constraint.z]], np.float32), heading)
            if constraint.constraint_id == VELOCITY_ID:
                targets.planned.add(constraint.frame)  # nobody asked for the place itself
        elif isinstance(constraint, RootTrajectory):
            stride = stride_frames if constraint.constraint_id == VELOCITY_ID else 1
            targets.add_lead(constraint.first_frame, constraint.xz, constraint.heading, stride)
        elif isinstance(constraint, JointTargets):
            positions, turns = constraint.positions, constraint.turns
            targets.add_joints(constraint.frame, constraint.joints, positions)
            if constraint.rotations is not None and turns:
                turned = [constraint.joints[index] for index in turns]
                targets.add_joints(constraint.frame, turned, positions[turns], constraint.rotations[turns])
        elif isinstance(constraint, HeadingTarget):
            targets.add_heading([constraint.frame], np.array([constraint.heading], np.float32))
        elif isinstance(constraint, JointRotations):
            targets.add_rotations(constraint.frame, constraint.joints, constraint.rotations)
        elif isinstance(constraint, Keyframe):
            targets.add_keyframes([constraint.frame], constraint.positions[None])
    return targets
