"""Jobs that belong to no session, to try a runner before it serves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motiongen_server.engine.ports import Runner
from motiongen_server.engine.types import (
    Constraint,
    Float32Array,
    Guidance,
    ModelFacts,
    PlanCause,
    Priority,
    SessionKey,
    StartPose,
    Waypoint,
    WindowJob,
)

_DEAREST = Guidance(1.5, 2.5)  # both weights need evaluations of their own
_CHEAPEST = Guidance(1.0, 0.0)  # without constraints, one evaluation in every mode of guidance


def trial_job(facts: ModelFacts, job_id: int, history: Float32Array, *, is_steered: bool = True) -> WindowJob:
    """A window like a session's: with a prompt, and with a history (H, D) if that is not empty.

    is_steered: with a waypoint and the most evaluations per step; else with the model's own guidance.
    """
    first_frame = len(history)
    waypoint: tuple[Constraint, ...] = (Waypoint(1, first_frame + facts.horizon - 1, 0.0, 1.0),)
    return WindowJob(
        job_id=job_id,
        session=SessionKey(0, 0),
        plan=1,
        first_frame=first_frame,
        history=history,
        start_pose=None if first_frame else StartPose(),
        embedding=np.full(facts.embedding_dim, facts.embedding_dim**-0.5, np.float32),
        constraints=waypoint if is_steered else (),
        seed=-job_id,
        num_steps=facts.min_steps,
        guidance=_DEAREST if is_steered else facts.guidance,
        deadline=0.0,
        priority=Priority.BATCH,
        cause=PlanCause.CONTINUE,
        created_at=0.0,
    )


def usual_passes(runner: Runner) -> int:
    """Evaluations per step of a window with a prompt only, at the model's own guidance."""
    nothing: Float32Array = np.zeros((0, runner.facts.feature_dim), np.float32)
    return runner.num_passes(trial_job(runner.facts, -1, nothing, is_steered=False))


def plain_job(facts: ModelFacts, job_id: int, history: Float32Array) -> WindowJob:
    """The same with the fewest evaluations per step: with a prompt, without constraints."""
    return replace(trial_job(facts, job_id, history, is_steered=False), guidance=_CHEAPEST)
