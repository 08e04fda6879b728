"""A job's constraints as ardy's targets."""

from __future__ import annotations

import torch

from motiongen_ardy.constraint import Targets
from motiongen_ardy.skeleton import Skeleton
from motiongen_server.engine.types import JointTargets, PoseTarget, RootPath, RootTarget, WindowJob


def job_targets(skeleton: Skeleton, job: WindowJob) -> Targets | None:
    """The job's constraints, None when it has none."""
    if not job.constraints:
        return None
    targets = Targets(skeleton)
    for constraint in job.constraints:
        if isinstance(constraint, RootTarget):
            heading = None if constraint.heading is None else torch.tensor([constraint.heading])
            targets.add_root([constraint.frame], torch.tensor([[constraint.x, constraint.z]]), heading)
        elif isinstance(constraint, RootPath):
            frames = range(constraint.first_frame, constraint.last_frame + 1)
            headings = None if constraint.heading is None else torch.from_numpy(constraint.heading)
            targets.add_root(frames, torch.from_numpy(constraint.xz), headings)
        elif isinstance(constraint, JointTargets):
            positions, turns = torch.from_numpy(constraint.positions), constraint.turns
            targets.add_joints(constraint.frame, constraint.joints, positions)
            if constraint.rotations is not None and turns:
                turned = [constraint.joints[index] for index in turns]
                rotations = torch.from_numpy(constraint.rotations)[turns]
                targets.add_joints(constraint.frame, turned, positions[turns], rotations)
        elif isinstance(constraint, PoseTarget):
            targets.add_full_body([constraint.frame], torch.from_numpy(constraint.positions)[None])
    return targets
