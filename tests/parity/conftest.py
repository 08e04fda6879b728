"""The runner on a tiny seeded model, and jobs for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.options import GuidanceOptions, PassMode, ProjectionOptions, SamplingOptions
from motiongen_server.engine.types import (
    Guidance,
    PlanCause,
    Priority,
    SessionKey,
    StartPose,
    Waypoint,
    WindowJob,
    WindowResult,
)
from motiongen_server.runner import TorchRunner

TINY = Path(__file__).parents[1] / "data" / "golden" / "tiny-core27" / "checkpoint"

# Rows share matrix products, whose order of summation depends on the number of rows; the difference is far below a
# level of the quantizer (1/32 of a latent), except for a value next to a rounding tie.
TOLERANCE = 2e-4


@pytest.fixture(scope="session")
def model() -> Model:
    return load_checkpoint(TINY)


@pytest.fixture
def runner(model: Model) -> TorchRunner:
    return TorchRunner(model, "tiny")


def make_job(job_id: int, model: Model, random: np.random.Generator) -> WindowJob:
    """A job with random values for everything in which the rows of a batch may differ."""
    dim = model.representation.feature_dim
    history_len = int(random.choice([0, 4, 8, 16]))
    first_frame = 100 if history_len else 0
    constraints: tuple[Waypoint, ...] = ()
    if random.random() < 0.5:
        frame = first_frame + int(random.integers(4, 70))
        constraints = (Waypoint(1, frame, float(random.normal()), float(random.normal()), 0.3),)
    return WindowJob(
        job_id=job_id,
        session=SessionKey(1, job_id),
        plan=int(random.integers(1, 50)),
        first_frame=first_frame,
        history=(0.5 * random.standard_normal((history_len, dim))).astype(np.float32),
        start_pose=None if history_len else StartPose(1.0, -2.0, 0.5),
        embedding=None if random.random() < 0.3 else random.standard_normal(32).astype(np.float32),
        constraints=constraints,
        seed=int(random.integers(1 << 62)),
        num_steps=int(random.choice([2, 4, 10])),
        guidance=Guidance(float(random.choice([0.0, 1.0, 2.0])), float(random.choice([0.0, 1.5]))),
        deadline=0.0,
        priority=Priority.NEAR,
        cause=PlanCause.CONTINUE,
        created_at=0.0,
    )


def projected_model(mode: PassMode, projection: ProjectionOptions) -> Model:
    """A copy of the model with planned and projected roots."""
    model = load_checkpoint(TINY)
    model.sampling = SamplingOptions(GuidanceOptions(mode, 1.0, 1.0), True, True, projection=projection)
    return model


def in_company(
    runner: TorchRunner,
    jobs: Mapping[int, WindowJob],
    joining: Callable[[], int],
    order: Callable[[list[int]], list[int]] = list,
) -> dict[int, WindowResult]:
    """The results of jobs run in one batch. joining: how many more start before a step; order: of a step's rows."""
    waiting, running, results = list(jobs), list[int](), dict[int, WindowResult]()
    while waiting or running:
        begun = [waiting.pop() for _ in range(min(len(waiting), joining()))]
        runner.prepare([jobs[job_id] for job_id in begun])
        running = order(running + begun)
        done = {status.job_id: status.steps_done for status in runner.denoise(running)}
        finished = [job_id for job_id in running if done[job_id] == jobs[job_id].num_steps]
        results.update((result.job_id, result) for result in (runner.decode(finished) if finished else ()))
        running = [job_id for job_id in running if job_id not in finished]
    return results
