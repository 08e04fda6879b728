"""Corrected windows are the same from the engine and from the reference rollout, alone and in a batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.model import Model
from motiongen_server.engine.types import JointTargets, Keyframe, WindowResult
from motiongen_server.runner import TorchRunner
from tests.parity.conftest import TINY, make_job
from tests.parity.test_batched_equals_alone import run_alone
from tests.parity.test_streamed_equals_rollout import compare, expected, stream

HAND = 16


@pytest.fixture(scope="module")
def correcting() -> Model:
    """The tiny model with feet, joints and the seams between windows corrected."""
    model = load_checkpoint(TINY)
    model.sampling = replace(model.sampling, clean_feet=True, reach_joints=True, join_tokens=True)
    return model


@pytest.fixture
def embedding() -> np.ndarray:
    return np.random.default_rng(3).standard_normal(32).astype(np.float32)


def hand_targets(model: Model) -> tuple[Targets, tuple[JointTargets, ...]]:
    """Targets for a hand at two frames, one of them early in a window: for the library and for the engine."""
    targets, constraints = Targets(model.skeleton), []
    for number, (frame, x) in enumerate(((43, 1.2), (90, 0.8)), 1):
        places = np.array([[x, 0.9, -1.8], [x + 0.3, 1.2, -1.6]], np.float32)
        targets.add_joints(frame, [0, HAND], torch.from_numpy(places))
        constraints.append(JointTargets(number, frame, (0, HAND), places))
    return targets, tuple(constraints)


@pytest.mark.parametrize("reuse_tokens", [False, True])
def test_session_streams_what_the_rollout_makes(correcting: Model, embedding: np.ndarray, reuse_tokens: bool) -> None:
    features = expected(correcting, embedding, None, reuse_tokens)
    compare(correcting, stream(correcting, embedding, (), reuse_tokens), features)


def test_session_with_joint_targets_streams_the_frames_of_the_rollout(correcting: Model, embedding: np.ndarray) -> None:
    targets, constraints = hand_targets(correcting)
    features = expected(correcting, embedding, targets, reuse_tokens=True)
    compare(correcting, stream(correcting, embedding, constraints, reuse_tokens=True), features)


def test_results_of_corrected_windows_carry_no_tokens(correcting: Model) -> None:
    job = make_job(1, correcting, np.random.default_rng(0))
    assert run_alone(correcting, job).tokens is None


@pytest.mark.parametrize("correction", ["clean_feet", "join_tokens"])
def test_correction_of_feet_or_seams_changes_the_frames_that_a_session_streams(
    correcting: Model, embedding: np.ndarray, correction: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    corrected = stream(correcting, embedding, (), reuse_tokens=False)
    others = replace(correcting.sampling, **{correction: False})  # type: ignore[arg-type]
    monkeypatch.setattr(correcting, "sampling", others)
    plain = stream(correcting, embedding, (), reuse_tokens=False)
    assert np.abs(plain - corrected)[:, :-4].max() > 0.01, "places and rotations"


def test_corrected_rows_are_the_same_in_a_batch_and_alone(correcting: Model) -> None:
    random = np.random.default_rng(5)
    jobs = {index: make_job(index, correcting, random) for index in range(1, 13)}
    pose = (correcting.skeleton.neutral_joints + np.array([1.0, 0.9, -2.0])).astype(np.float32)
    for index in (2, 5, 8):
        jobs[index] = replace(jobs[index], constraints=(Keyframe(9, jobs[index].first_frame + 20, pose),))
    runner = TorchRunner(correcting, "tiny")
    runner.prepare(list(jobs.values()))
    left = dict.fromkeys(jobs, 0)
    while pending := [index for index in jobs if left[index] < jobs[index].num_steps]:
        for status in runner.denoise(pending):
            left[status.job_id] = status.steps_done
    results: dict[int, WindowResult] = {result.job_id: result for result in runner.decode(list(jobs))}
    for index, job in jobs.items():
        alone = run_alone(correcting, job)
        np.testing.assert_allclose(results[index].frames[:, :3], alone.frames[:, :3], atol=2e-3)
        np.testing.assert_allclose(results[index].features, alone.features, atol=5e-3)
