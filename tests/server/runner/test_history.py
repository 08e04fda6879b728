"""A history gives the same window as tokens and as features, which the runner encodes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_server.engine.types import WindowJob, WindowResult
from motiongen_server.runner import TorchRunner
from tests.parity.conftest import TOLERANCE, make_job

TINY = Path(__file__).parents[2] / "data" / "golden" / "tiny-core27" / "checkpoint"


def run(runner: TorchRunner, job: WindowJob) -> WindowResult:
    runner.prepare([job])
    for _ in range(job.num_steps):
        runner.denoise([job.job_id])
    return runner.decode([job.job_id])[0]


def test_tokens_and_features_of_a_history_give_the_same_window() -> None:
    model = load_checkpoint(TINY)
    runner = TorchRunner(model, "tiny")
    job = replace(make_job(1, model, np.random.default_rng(3)), first_frame=100, start_pose=None)
    dim = model.representation.feature_dim
    features = (0.3 * np.random.default_rng(4).standard_normal((16, dim))).astype(np.float32)
    first = run(runner, replace(job, job_id=1, history=features))
    encoded = model.codec.to_hybrid(torch.from_numpy(features)[None])[0].numpy()
    second = run(runner, replace(job, job_id=2, history=features, history_tokens=encoded))
    assert np.abs(first.frames - second.frames).max() < TOLERANCE


def test_histories_with_and_without_tokens_stay_with_their_windows_in_one_batch() -> None:
    model = load_checkpoint(TINY)
    runner = TorchRunner(model, "tiny")
    random = np.random.default_rng(6)
    jobs = []
    for number in range(4):
        features = (0.3 * random.standard_normal((8, model.representation.feature_dim))).astype(np.float32)
        tokens = model.codec.to_hybrid(torch.from_numpy(features)[None])[0].numpy() if number % 2 else None
        job = replace(make_job(number, model, random), first_frame=100, start_pose=None, constraints=())
        jobs.append(replace(job, history=features, history_tokens=tokens))
    runner.prepare(jobs)
    together = [runner.row(job.job_id).history for job in jobs]
    for job, history in zip(jobs, together, strict=True):
        alone = TorchRunner(model, "tiny")
        alone.prepare([job])
        assert (history - alone.row(job.job_id).history).abs().max() < TOLERANCE, job.job_id


def test_root_part_of_a_window_s_tokens_equals_its_features() -> None:
    model = load_checkpoint(TINY)
    runner = TorchRunner(model, "tiny")
    job = replace(make_job(1, model, np.random.default_rng(5)), history=np.zeros((0, 1), np.float32))
    result = run(runner, job)
    assert result.tokens is not None
    assert result.tokens.shape == (runner.facts.horizon // runner.facts.patch, runner.facts.token_width)
    root = result.tokens[:, :20].reshape(-1, 5)
    assert np.abs(root - result.features[:, :5]).max() < 1e-6
