"""A job's constraints as ardy's targets."""

from __future__ import annotations

import torch

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
    """The job's constraints, None when it has none.

    stride_frames: of the frames through which a velocity leads, one in so many is asked for; the root may sway between.
    """
    if not job.constraints:
        return None
    targets = Targets(skeleton)
    for constraint in job.constraints:
        if isinstance(constraint, Waypoint):
            heading = None if constraint.heading is None else torch.tensor([constraint.heading])
            targets.add_waypoints([constraint.frame], torch.tensor([[constraint.x, constraint.z]]), heading)
            if constraint.constraint_id == VELOCITY_ID:
                targets.planned.add(constraint.frame)  # nobody asked for the place itself
        elif isinstance(constraint, RootTrajectory):
            headings = None if constraint.heading is None else torch.from_numpy(constraint.heading)
            stride = stride_frames if constraint.constraint_id == VELOCITY_ID else 1
            targets.add_lead(constraint.first_frame, torch.from_numpy(constraint.xz), headings, stride)
        elif isinstance(constraint, JointTargets):
            positions, turns = torch.from_numpy(constraint.positions), constraint.turns
            targets.add_joints(constraint.frame, constraint.joints, positions)
            if constraint.rotations is not None and turns:
                turned = [constraint.joints[index] for index in turns]
                rotations = torch.from_numpy(constraint.rotations)[turns]
                targets.add_joints(constraint.frame, turned, positions[turns], rotations)
        elif isinstance(constraint, HeadingTarget):
            targets.add_heading([constraint.frame], torch.tensor([constraint.heading]))
        elif isinstance(constraint, JointRotations):
            targets.add_rotations(constraint.frame, constraint.joints, torch.from_numpy(constraint.rotations))
        elif isinstance(constraint, Keyframe):
            targets.add_keyframes([constraint.frame], torch.from_numpy(constraint.positions)[None])
    return targets
