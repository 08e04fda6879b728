"""Led roots, which are predicted once and then kept: the same as in the rollout, and the same in any batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.options import ProjectionOptions
from motiongen_server.engine.types import RootTrajectory, WindowJob
from motiongen_server.runner import TorchRunner
from tests.parity.conftest import in_company, make_job, projected_model
from tests.parity.test_batched_equals_alone import run_alone, share_of_close_frames
from tests.parity.test_streamed_equals_rollout import compare, expected, stream

FRAMES = 160


@pytest.fixture(params=["joint", "separated"])
def led(request: pytest.FixtureRequest) -> Model:
    """A model that predicts a led root once."""
    return projected_model(request.param, ProjectionOptions(led_steps=1))


def circle(num_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Ground positions (T, 2) and headings (T) of a path around a circle."""
    angle = np.arange(num_frames, dtype=np.float32) / 40
    return np.stack([2 * (1 - np.cos(angle)), 2 * np.sin(angle)], axis=1), angle


def job_on_the_circle(job_id: int, model: Model, random: np.random.Generator) -> WindowJob:
    """A random job whose root is led along the circle."""
    job = make_job(job_id, model, random)
    ground, heading = circle(60)
    path = RootTrajectory(1, job.first_frame, ground, heading)
    return replace(job, constraints=(path,))


MAKE = (job_on_the_circle, make_job)


def test_session_on_a_root_trajectory_streams_the_frames_of_the_rollout(led: Model) -> None:
    embedding = np.random.default_rng(3).standard_normal(32).astype(np.float32)
    ground, heading = circle(FRAMES)
    targets = Targets(led.skeleton)
    targets.add_waypoints(range(FRAMES), torch.from_numpy(ground), torch.from_numpy(heading))
    features = expected(led, embedding, targets, False)
    compare(led, stream(led, embedding, (RootTrajectory(1, 0, ground, heading),), False), features)
    led.sampling = replace(led.sampling, projection=ProjectionOptions())
    assert not torch.allclose(features, expected(led, embedding, targets, False), atol=1e-3), "no root was kept"


def test_led_rows_are_the_same_in_a_batch_and_alone(led: Model) -> None:
    random = np.random.default_rng(5)
    jobs = {index: MAKE[index % 2](index, led, random) for index in range(1, 17)}
    # Jobs join at different steps, so that in one step some keep their roots and others do not.
    results = in_company(TorchRunner(led, "tiny"), jobs, lambda: 5)
    shares = [share_of_close_frames(results[job_id], run_alone(led, job)) for job_id, job in jobs.items()]
    assert np.mean(shares) > 0.95, shares


def test_first_stage_is_evaluated_only_for_rows_that_keep_no_root(led: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(7)
    led_job, other = (replace(make(1 + n, led, random), num_steps=4) for n, make in enumerate(MAKE))
    runner = TorchRunner(led, "tiny")
    first, sequences = runner._denoiser.stages[0], []
    output = first.output

    def count(vectors: torch.Tensor) -> torch.Tensor:
        sequences.append(len(vectors))
        result: torch.Tensor = output(vectors)
        return result

    monkeypatch.setattr(first, "output", count)
    runner.prepare([led_job, other])
    passes = [runner.num_passes(job) for job in (led_job, other)]
    for step in range(2):
        runner.denoise([1, 2])
        assert runner.row(1).is_led
        assert not runner.row(2).is_led
        assert sequences == [sum(passes), passes[1]][: step + 1]
    runner.discard([2])
    runner.denoise([1])
    assert len(sequences) == 2
