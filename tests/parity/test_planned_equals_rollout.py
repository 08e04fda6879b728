"""Planned roots: a session and a rollout give the same frames, and a row is the same in a batch and alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.options import ProjectionOptions
from motiongen_server.engine.types import RootTrajectory, Waypoint
from motiongen_server.runner import TorchRunner
from tests.parity.conftest import in_company, make_job, projected_model
from tests.parity.test_batched_equals_alone import run_alone, share_of_close_frames
from tests.parity.test_streamed_equals_rollout import compare, expected, stream


@pytest.fixture(params=["joint", "separated"])
def planned(request: pytest.FixtureRequest) -> Model:
    return projected_model(request.param, ProjectionOptions(last_steps=2))


def test_session_with_waypoints_streams_the_frames_of_the_rollout(planned: Model) -> None:
    embedding = np.random.default_rng(2).standard_normal(32).astype(np.float32)
    targets = Targets(planned.skeleton)
    targets.add_waypoints([30], torch.tensor([[1.5, -1.0]]))
    targets.add_waypoints([110], torch.tensor([[2.0, 0.5]]), torch.tensor([0.4]))
    constraints = (Waypoint(1, 30, 1.5, -1.0), Waypoint(2, 110, 2.0, 0.5, 0.4))
    features = expected(planned, embedding, targets, False)
    compare(planned, stream(planned, embedding, constraints, False), features)
    ground = features[[30, 110]][:, [0, 2]]
    assert torch.allclose(ground, torch.tensor([[1.5, -1.0], [2.0, 0.5]]), atol=2e-3)


def test_session_on_a_root_trajectory_streams_the_frames_of_the_rollout(planned: Model) -> None:
    embedding = np.random.default_rng(3).standard_normal(32).astype(np.float32)
    time = np.arange(80, dtype=np.float32)[:, None] / 20
    xz = np.concatenate([1.0 + 0.5 * time, -2.0 + 0.8 * time], axis=1)
    targets = Targets(planned.skeleton)
    targets.add_waypoints(range(80), torch.from_numpy(xz))
    features = expected(planned, embedding, targets, False)
    compare(planned, stream(planned, embedding, (RootTrajectory(1, 0, xz),), False), features)
    assert torch.allclose(features[30:80, [0, 2]], torch.from_numpy(xz[30:]), atol=2e-3)


def test_session_without_targets_slows_down_like_the_rollout(planned: Model) -> None:
    embedding = np.random.default_rng(6).standard_normal(32).astype(np.float32)
    features = expected(planned, embedding, None, False)
    compare(planned, stream(planned, embedding, (), False), features)
    planned.sampling = replace(planned.sampling, projection=ProjectionOptions(last_steps=2, slowing_s=0.0))
    assert not torch.allclose(features, expected(planned, embedding, None, False), atol=0.05), "nothing was slowed"


def test_planned_rows_are_the_same_in_a_batch_and_alone(planned: Model) -> None:
    random = np.random.default_rng(5)
    jobs = {index: make_job(index, planned, random) for index in range(1, 13)}
    results = in_company(TorchRunner(planned, "tiny"), jobs, lambda: len(jobs))
    shares = [share_of_close_frames(results[job_id], run_alone(planned, job)) for job_id, job in jobs.items()]
    assert np.mean(shares) > 0.95, shares
