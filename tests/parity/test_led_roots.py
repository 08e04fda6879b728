"""Roots that are kept once they have been predicted: as the rollout has them, and the same in any company."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.options import GuidanceOptions, ProjectionOptions, SamplingOptions
from motiongen_server.engine.types import RootTrajectory, WindowJob
from motiongen_server.runner import TorchRunner
from tests.parity.conftest import TINY, make_job
from tests.parity.test_batched_equals_alone import run_alone, share_of_close_frames
from tests.parity.test_streamed_equals_rollout import compare, expected, stream

FRAMES = 160


@pytest.fixture(params=["joint", "separated"])
def led(request: pytest.FixtureRequest) -> Model:
    """A model that predicts a led root once."""
    model = load_checkpoint(TINY)
    guidance = GuidanceOptions(request.param, 1.0, 1.0)
    model.sampling = SamplingOptions(guidance, True, True, projection=ProjectionOptions(led_steps=1))
    return model


def circle(num_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Ground positions (T, 2) and headings (T) of a way round a circle."""
    angle = np.arange(num_frames, dtype=np.float32) / 40
    return np.stack([2 * (1 - np.cos(angle)), 2 * np.sin(angle)], axis=1), angle


def job_on_the_circle(job_id: int, model: Model, random: np.random.Generator) -> WindowJob:
    """A job that differs from others in all that it may, and is led."""
    job = make_job(job_id, model, random)
    ground, heading = circle(60)
    path = RootTrajectory(1, job.first_frame, ground.astype(np.float32), heading)
    return replace(job, constraints=(path,))


MAKE = (job_on_the_circle, make_job)


def test_a_session_on_a_path_is_the_rollout(led: Model) -> None:
    embedding = np.random.default_rng(3).standard_normal(32).astype(np.float32)
    ground, heading = circle(FRAMES)
    targets = Targets(led.skeleton)
    targets.add_waypoints(range(FRAMES), torch.from_numpy(ground), torch.from_numpy(heading))
    features = expected(led, embedding, targets, False)
    compare(led, stream(led, embedding, (RootTrajectory(1, 0, ground, heading),), False), features)
    again = replace(led.sampling, projection=ProjectionOptions())
    led.sampling = again
    assert not torch.allclose(features, expected(led, embedding, targets, False), atol=1e-3), "no root was kept"


def test_led_rows_get_in_company_what_they_get_alone(led: Model) -> None:
    random = np.random.default_rng(5)
    jobs = {index: MAKE[index % 2](index, led, random) for index in range(1, 17)}
    runner, waiting, running, shares = TorchRunner(led, "tiny"), list(jobs), list[int](), list[float]()
    while waiting or running:  # they join at different steps, so that some keep their roots and others do not
        joining = [waiting.pop() for _ in range(min(len(waiting), 5))]
        runner.prepare([jobs[job_id] for job_id in joining])
        running += joining
        done = {status.job_id: status.steps_done for status in runner.denoise(running)}
        finished = [job_id for job_id in running if done[job_id] == jobs[job_id].num_steps]
        for result in runner.decode(finished) if finished else ():
            shares.append(share_of_close_frames(result, run_alone(led, jobs[result.job_id])))
        running = [job_id for job_id in running if job_id not in finished]
    assert np.mean(shares) > 0.95, shares


def test_the_first_stage_is_evaluated_for_those_alone_who_keep_no_root(
    led: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
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
