"""The residuals of the server equal those of the model library, on random motion of both skeletons."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.residuals import residuals as library_residuals
from motiongen_ardy.core.rotation import matrix_to_quaternion, quaternion_to_matrix
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_server.engine.session.kinematics import Posed
from motiongen_server.engine.session.residuals import Residual, nearest_by_waypoint, nearest_frame
from motiongen_server.engine.types import (
    ChannelBlock,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RigLayout,
    RootTrajectory,
    Span,
    Tolerance,
    Waypoint,
    WindowJob,
)
from motiongen_server.runner.targets import job_targets

NUM_FRAMES = 30


def layout_of(skeleton: Any) -> RigLayout:
    blocks = (
        ChannelBlock("root_translation_m", 3),
        ChannelBlock("joint_rotation_quat_wxyz", 4 * skeleton.num_joints),
        ChannelBlock("foot_contact", 4),
    )
    offsets = skeleton.offsets.astype(np.float32)
    return RigLayout(skeleton.name, skeleton.joint_names, skeleton.parents, offsets, blocks, skeleton.hip_joints)


@pytest.mark.parametrize("name", ["core27", "g134"])
def test_residuals_equal_those_of_the_library(name: str) -> None:
    skeleton = load_skeleton(name)
    numbers = np.random.default_rng(7)
    joints = skeleton.num_joints
    quaternions = torch.from_numpy(numbers.normal(size=(NUM_FRAMES, joints, 4)))
    rotations = quaternion_to_matrix(quaternions / quaternions.norm(dim=-1, keepdim=True))
    root = torch.from_numpy(numbers.normal(size=(NUM_FRAMES, 3)))
    rows = torch.cat([root, matrix_to_quaternion(rotations).flatten(1), torch.zeros(NUM_FRAMES, 4)], dim=1)
    turns = quaternion_to_matrix(torch.nn.functional.normalize(torch.from_numpy(numbers.normal(size=(2, 4))), dim=-1))
    points = numbers.normal(size=(joints, 3)).astype(np.float32)
    constraints = (
        Waypoint(1, 4, 0.5, -1.0, 2.0),
        Waypoint(2, 5, 0.5, -1.0),
        RootTrajectory(3, 24, points[:10, :2].copy(), points[:10, 2].copy()),
        JointTargets(4, 9, (0, 3), points[:2].copy(), turns.float().numpy()),
        Keyframe(5, 29, points),
        Waypoint(6, 44, 0.0, 0.0),
        JointTargets(7, 10, (0, 5), points[:2].copy(), turns.float().numpy(), (False, True)),
        HeadingTarget(8, 11, -2.5),
        JointRotations(9, 12, (4, 0), turns.float().numpy()),
    )
    measured = [measured_in_parts(skeleton, constraint, rows.numpy().astype(np.float32)) for constraint in constraints]
    targets = [targets_of(skeleton, constraint) for constraint in constraints]
    motion = Motion(rotations, root, torch.zeros(NUM_FRAMES, 4, dtype=torch.bool), 20)
    for number, (ours, theirs) in enumerate(zip(measured, library_residuals(motion, targets), strict=True)):
        assert ours.num_frames == theirs.num_frames
        for kind in ("position_m", "heading_rad", "rotation_rad"):
            expected = getattr(theirs, kind)
            assert (getattr(ours, kind) is not None) == (expected is not None), (number, kind)
            if expected is not None:
                assert getattr(ours, kind).mean == pytest.approx(expected.mean, abs=1e-4)
                assert getattr(ours, kind).worst == pytest.approx(expected.worst, abs=1e-4)


def test_waypoints_measured_together_have_the_residuals_of_each_alone() -> None:
    numbers = np.random.default_rng(8)
    posed = Posed(layout_of(load_skeleton("core27")), numbers.normal(size=(12, 115)).astype(np.float32))
    first, last = 100, 111
    waypoints = []
    for number in range(1, 60):
        begin = int(numbers.integers(90, last + 1))
        span = Span(begin, int(numbers.integers(max(begin, first), 130)))
        tolerance = Tolerance(float(numbers.choice([0.0, 0.1, 2.0])), 0.1)
        x, z = numbers.normal(size=2).tolist()
        waypoints.append(Waypoint(number, span.first, x, z, tolerance=tolerance, span=span))
    for waypoint, together in zip(waypoints, nearest_by_waypoint(waypoints, first, posed), strict=True):
        begin, end = max(waypoint.first_frame, first), min(waypoint.last_frame, last) + 1
        alone = nearest_frame(waypoint, begin, posed.part(begin - first, end - first))
        assert (together.frame, together.excess) == (alone.frame, alone.excess)
        assert together.residual.position_m == alone.residual.position_m
        assert together.residual.num_frames == alone.residual.num_frames == 1


def measured_in_parts(skeleton: Any, constraint: Any, rows: Any) -> Residual:
    """The residual, measured frame after frame as they are committed."""
    residual = Residual()
    for frame in range(constraint.first_frame, min(constraint.last_frame + 1, NUM_FRAMES)):
        residual.add(constraint, frame, Posed(layout_of(skeleton), rows[frame : frame + 1]))
    return residual


def targets_of(skeleton: Any, constraint: Any) -> Targets:
    job: Any = WindowJob.__new__(WindowJob)
    object.__setattr__(job, "constraints", (constraint,))
    targets = job_targets(skeleton, job)
    assert targets is not None
    return targets


def test_residual_equal_to_the_tolerance_is_within_unless_a_foot_is_lifted() -> None:
    off = Residual(1, [np.array([0.25])], [np.array([0.5])], [np.array([0.5])])
    assert off.is_within(Tolerance(0.25, 0.5))
    assert not off.is_within(Tolerance(0.24, 0.5))
    assert not off.is_within(Tolerance(0.25, 0.49))
    assert not Residual(1, [], [], [np.array([0.5])]).is_within(Tolerance(0.25, 0.49))
    assert not Residual(1, [], [np.array([0.5])]).is_within(Tolerance(0.25, 0.49))
    assert not replace(off, lifted=[np.array([False, True])]).is_within(Tolerance(9.0, 9.0))
    assert replace(off, lifted=[np.array([False, False])]).is_within(Tolerance(9.0, 9.0))
