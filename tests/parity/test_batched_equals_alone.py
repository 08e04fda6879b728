"""A row's result does not depend on the other rows of its batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.model import Model
from motiongen_server.engine.types import WindowJob, WindowResult
from motiongen_server.runner import TorchRunner
from tests.parity.conftest import TOLERANCE, in_company, make_job
from tests.steered_jobs import MINI, all_kinds, played


def run_alone(model: Model, job: WindowJob) -> WindowResult:
    runner = TorchRunner(model, "tiny")
    runner.prepare([job])
    for _ in range(job.num_steps):
        (status,) = runner.denoise([job.job_id])
        assert status.finite
    return runner.decode([job.job_id])[0]


def share_of_close_frames(one: WindowResult, other: WindowResult) -> float:
    difference = np.abs(one.features - other.features).max(axis=1)
    return float((difference < TOLERANCE).mean())


@pytest.mark.parametrize("num_jobs", [2, 7, 24, 128])
def test_rows_joining_and_leaving_at_different_steps_match_rows_run_alone(
    model: Model, runner: TorchRunner, num_jobs: int
) -> None:
    random = np.random.default_rng(num_jobs)
    jobs = {index: make_job(index, model, random) for index in range(1, num_jobs + 1)}
    results = in_company(
        runner,
        jobs,
        lambda: int(random.integers(1, 2 + num_jobs // 4)),
        lambda running: list(random.permutation(running)),
    )
    shares = [share_of_close_frames(results[job_id], run_alone(model, job)) for job_id, job in jobs.items()]
    # A latent on a rounding tie may be rounded the other way; that is rare, and everything else is equal.
    assert np.mean(shares) > 0.98, shares


def test_row_with_nan_history_is_told_as_not_finite_and_does_not_change_its_neighbour(model: Model) -> None:
    random = np.random.default_rng(0)
    good, bad = make_job(1, model, random), make_job(2, model, random)
    poisoned = np.full((8, model.representation.feature_dim), np.nan, np.float32)
    runner = TorchRunner(model, "tiny")
    runner.prepare([good])
    runner.prepare([replace(bad, history=poisoned, start_pose=None)])
    assert [status.finite for status in runner.denoise([1, 2])] == [True, False], "in its first step"
    for _ in range(min(good.num_steps, bad.num_steps) - 1):
        assert [status.finite for status in runner.denoise([1, 2])] == [True, False]
    runner.discard([2])
    for _ in range(good.num_steps - bad.num_steps):
        assert [status.finite for status in runner.denoise([1])] == [True]
    (with_bad,) = runner.decode([1])
    alone = run_alone(model, good)
    assert np.abs(with_bad.features - alone.features).max() < TOLERANCE


def test_denoising_a_discarded_job_raises_key_error(model: Model, runner: TorchRunner) -> None:
    job = make_job(1, model, np.random.default_rng(3))
    runner.prepare([job])
    runner.discard([1, 99])
    with pytest.raises(KeyError):
        runner.denoise([1])


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
def test_one_denoising_step_gives_each_row_the_tokens_it_gets_alone(model: Model, precision: torch.dtype) -> None:
    random = np.random.default_rng(5)
    jobs = [make_job(index, model, random) for index in range(1, 129)]

    def tokens(batch: list[WindowJob]) -> dict[int, torch.Tensor]:
        runner = TorchRunner(model, "tiny", precision=precision)
        runner.prepare(batch)
        runner.denoise([job.job_id for job in batch])
        return {job.job_id: runner.row(job.job_id).tokens for job in batch}

    alone = {job.job_id: tokens([job])[job.job_id] for job in jobs[:8]}
    for num_rows in (2, 3, 5, 8, 24, 128):
        together = tokens(jobs[:num_rows])
        for job_id in alone.keys() & together.keys():
            assert (together[job_id] - alone[job_id]).abs().max() < 1e-5


@pytest.mark.parametrize("num_rows", [2, 5, 8])
def test_frames_and_features_of_steered_rows_are_equal_in_a_batch_and_alone(num_rows: int) -> None:
    mini = load_checkpoint(MINI)
    begun = played(TorchRunner(mini, "mini"), all_kinds(mini))
    kinds = [*all_kinds(mini, begun), *(replace(job, job_id=job.job_id + 10) for job in all_kinds(mini, begun[::-1]))]
    jobs = kinds[:num_rows]
    together = played(TorchRunner(mini, "mini"), jobs)
    for job, result in zip(jobs, together, strict=True):
        (alone,) = played(TorchRunner(mini, "mini"), [job])
        assert np.array_equal(result.frames, alone.frames), job.job_id
        assert np.array_equal(result.features, alone.features), job.job_id
