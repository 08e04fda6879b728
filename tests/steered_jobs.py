"""Jobs of steered windows: with constraints of every kind, and with a velocity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motiongen_ardy.checkpoint.model_card import model_folder
from motiongen_ardy.model.model import Model
from motiongen_server.engine.ports import Runner
from motiongen_server.engine.types import (
    VELOCITY_ID,
    Constraint,
    Guidance,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    PlanCause,
    Priority,
    RootTrajectory,
    SessionKey,
    StartPose,
    Waypoint,
    WindowJob,
    WindowResult,
)

MINI = model_folder("motiongen-mini")
HAND = 17  # of the built-in model's skeleton


def job(
    number: int, model: Model, history: np.ndarray, constraints: tuple[Constraint, ...], is_told: bool
) -> WindowJob:
    width = model.config.denoiser.text_dim
    return WindowJob(
        job_id=number,
        session=SessionKey(1, number),
        plan=1 if not len(history) else 2,
        first_frame=40 if len(history) else 0,
        history=history,
        start_pose=None if len(history) else StartPose(1.0, -2.0, 0.5),
        embedding=np.full(width, 0.05, np.float32) if is_told else None,
        constraints=constraints,
        seed=number,
        num_steps=2,
        guidance=Guidance(1.5, 1.5) if number % 2 else Guidance(1.0, 1.0),
        deadline=0.0,
        priority=Priority.NEAR,
        cause=PlanCause.CONTINUE,
        created_at=0.0,
    )


def asked(model: Model, first: int) -> list[tuple[Constraint, ...]]:
    """Constraints of every kind, and a velocity."""
    pose = (model.skeleton.neutral_joints + np.array([0.2, 0.95, 0.3])).astype(np.float32)
    places = np.array([[0.0, 0.9, 0.5], [0.3, 1.2, 0.7]], np.float32)
    way = np.linspace((0.0, 0.0), (0.3, 2.0), 40, dtype=np.float32)
    turns = np.eye(3, dtype=np.float32)[None]
    return [
        (),
        (Waypoint(1, first + 30, 1.0, 1.0, 0.3),),
        (RootTrajectory(VELOCITY_ID, first, way),),
        (HeadingTarget(1, first + 20, 1.0), JointRotations(2, first + 25, (HAND,), turns)),
        (JointTargets(1, first + 20, (0, HAND), places), Keyframe(2, first + 50, pose)),
        (Waypoint(VELOCITY_ID, first + 15, 0.0, 0.2), JointTargets(1, first + 15, (HAND,), places[1:])),
    ]


def played(runner: Runner, jobs: Sequence[WindowJob]) -> list[WindowResult]:
    """Run jobs of two steps together. Raises AssertionError if a number is not finite."""
    runner.prepare(jobs)
    ids = [each.job_id for each in jobs]
    for _ in range(2):
        assert all(status.finite for status in runner.denoise(ids))
    return runner.decode(ids)


def all_kinds(model: Model, before: Sequence[WindowResult] = ()) -> list[WindowJob]:
    """A job for each of `asked`: first windows, or windows that continue given results."""
    none = np.zeros((0, model.representation.feature_dim), np.float32)
    return [
        job(index, model, before[index].features[-16:] if before else none, each, bool(index))
        for index, each in enumerate(asked(model, 40 if before else 0))
    ]
