"""The baselines compute the same as the served runner, so that comparisons are about speed alone."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_ardy.model.model import Model
from motiongen_server.engine.ports import Runner
from motiongen_server.engine.types import WindowJob, WindowResult
from motiongen_server.runner import TorchRunner
from tests.bench.plain_runner import PlainRunner, RolloutRunner
from tests.parity.conftest import TINY, TOLERANCE, make_job


@pytest.fixture(scope="module")
def model() -> Model:
    from motiongen_ardy.checkpoint.checkpoint import load_checkpoint

    return load_checkpoint(TINY)


def run(runner: Runner, jobs: list[WindowJob]) -> list[WindowResult]:
    """Run all jobs together, each for its number of steps."""
    runner.prepare(jobs)
    results: dict[int, WindowResult] = {}
    for done in range(max(job.num_steps for job in jobs)):
        running = [job.job_id for job in jobs if job.num_steps > done]
        assert all(status.finite for status in runner.denoise(running))
        finished = [job.job_id for job in jobs if job.num_steps == done + 1]
        if finished:
            results.update((result.job_id, result) for result in runner.decode(finished))
    return [results[job.job_id] for job in jobs]


@pytest.mark.parametrize("baseline", [RolloutRunner, PlainRunner])
def test_baseline_gives_the_same_frames_as_the_served_runner(baseline: type[RolloutRunner], model: Model) -> None:
    random = np.random.default_rng(5)
    jobs = [make_job(job_id, model, random) for job_id in range(1, 9)]
    plain, served = run(baseline(model, "tiny"), jobs), run(TorchRunner(model, "tiny"), jobs)
    close = [
        np.abs(one.features - other.features).max(axis=1) < TOLERANCE for one, other in zip(plain, served, strict=True)
    ]
    # A latent that lies on a rounding tie may fall to the other side; that is rare, and everything else is equal.
    assert np.mean(close) > 0.98
