"""Prompts that contradict the waypoints: session and rollout give the model the same, in windows of equal length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.options import GuidanceOptions, SamplingOptions
from motiongen_ardy.model.sampling.paces import PromptPaces
from motiongen_server.engine.types import Constraint, Waypoint
from motiongen_server.runner import TorchRunner
from tests.parity.conftest import TINY, make_job
from tests.parity.test_batched_equals_alone import run_alone
from tests.parity.test_streamed_equals_rollout import compare, expected, stream

GOALS = ((33, 2.6, -1.0), (110, 2.6, -1.0))


@pytest.fixture(scope="module")
def embedding() -> np.ndarray:
    return np.random.default_rng(2).standard_normal(32).astype(np.float32)


@pytest.fixture(scope="module")
def fitting(embedding: np.ndarray) -> Model:
    """The tiny model, which knows one caption, of standing, and one gait."""
    model = load_checkpoint(TINY)
    model.sampling = SamplingOptions(GuidanceOptions("joint", 1.0, 1.0), True, True, fit_prompts=True)
    text = torch.from_numpy(embedding)
    model.paces = PromptPaces(
        mean=torch.zeros(32),
        directions=text[None] / text.norm(),
        speeds=torch.tensor([[0.0, 0.1]]),
        threshold=0.5,
        gaits=torch.randn(1, 32, generator=torch.Generator().manual_seed(1)),
        from_mps=torch.zeros(1),
        quarters=torch.zeros(1),
    )
    return model


@pytest.fixture
def goals(fitting: Model) -> tuple[Targets, tuple[Constraint, ...]]:
    """Waypoints that ask for a walk of 1.7 s and then for staying there."""
    targets = Targets(fitting.skeleton)
    for frame, x, z in GOALS:
        targets.add_waypoints([frame], torch.tensor([[x, z]]))
    return targets, tuple(Waypoint(number, *goal) for number, goal in enumerate(GOALS, 1))


@pytest.mark.parametrize("reuse_tokens", [False, True])
def test_session_with_fitted_prompts_streams_the_frames_of_the_rollout(
    fitting: Model, embedding: np.ndarray, goals: tuple[Targets, tuple[Constraint, ...]], reuse_tokens: bool
) -> None:
    features = expected(fitting, embedding, goals[0], reuse_tokens)
    compare(fitting, stream(fitting, embedding, goals[1], reuse_tokens), features)


def test_keep_prompts_turns_the_fitting_of_prompts_off(
    fitting: Model, embedding: np.ndarray, goals: tuple[Targets, tuple[Constraint, ...]]
) -> None:
    plain = load_checkpoint(TINY)
    plain.sampling = replace(fitting.sampling, fit_prompts=False)
    kept = expected(fitting, embedding, goals[0], False, keep_prompts=True)
    assert torch.equal(kept, expected(plain, embedding, goals[0], False))
    assert not torch.allclose(kept, expected(fitting, embedding, goals[0], False), atol=0.01)
    compare(fitting, stream(fitting, embedding, goals[1], False, keep_prompts=True), kept)


def test_window_with_a_fitted_prompt_ends_at_its_waypoint(fitting: Model, embedding: np.ndarray) -> None:
    job = make_job(1, fitting, np.random.default_rng(0))
    goal = Waypoint(1, job.first_frame + 24, 2.0, 0.0)
    job = replace(job, embedding=embedding, constraints=(goal,))
    result = run_alone(fitting, job)
    assert len(result.frames) == len(result.features) == 25
    assert len(run_alone(fitting, replace(job, keep_prompt=True)).frames) == fitting.config.horizon


def test_each_row_of_a_batch_ends_at_its_own_waypoint_or_at_the_horizon(fitting: Model, embedding: np.ndarray) -> None:
    base = make_job(1, fitting, np.random.default_rng(0))
    jobs = [
        replace(base, job_id=number, embedding=embedding, constraints=(Waypoint(1, base.first_frame + far, 3.0, 0.0),))
        for number, far in ((1, 24), (2, 31), (3, 60))
    ]
    runner = TorchRunner(fitting, "tiny")
    runner.prepare(jobs)
    for _ in range(base.num_steps):
        runner.denoise([1, 2, 3])
    assert [len(result.frames) for result in runner.decode([1, 2, 3])] == [25, 32, 40]
