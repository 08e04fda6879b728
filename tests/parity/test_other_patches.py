"""Models with other patches: sessions match rollouts, corrected and not, and an engine can be built for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.config import ConfigError, ModelConfig
from motiongen_ardy.model.model import Model, build_model
from motiongen_ardy.model.rollout import usual_history
from motiongen_server.config import ServerConfig
from motiongen_server.engine.types import (
    Closed,
    Guidance,
    Open,
    Output,
    Priority,
    SessionSpec,
    Waypoint,
    WindowJob,
)
from motiongen_server.engine_process.model_loading import build_engine
from motiongen_server.runner import TorchRunner
from tests.parity.test_streamed_equals_rollout import KEY, compare, expected, stream

PATCHES = (1, 5, 8)


class Recording(TorchRunner):
    """A runner that keeps the jobs of its sessions."""

    def __init__(self, model: Model, model_id: str) -> None:
        super().__init__(model, model_id)
        self.begun: list[WindowJob] = []

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        self.begun += [job for job in jobs if job.job_id > 0]
        super().prepare(jobs)


def with_patch(config: ModelConfig, patch: int) -> ModelConfig:
    assert config.tokenizer is not None
    tokenizer, denoiser = replace(config.tokenizer, patch=patch), replace(config.denoiser, patch=patch)
    return replace(config, tokenizer=tokenizer, denoiser=denoiser)


@pytest.fixture(scope="module", params=PATCHES)
def other(request: pytest.FixtureRequest, model: Model) -> Model:
    """The tiny model with another patch and random weights."""
    torch.manual_seed(request.param)
    made = build_model(with_patch(model.config, request.param), model.representation.stats)
    return made.eval().requires_grad_(False)


@pytest.mark.parametrize("corrects", [False, True])
@pytest.mark.parametrize("reuse_tokens", [False, True])
def test_session_streams_the_frames_of_the_rollout(other: Model, corrects: bool, reuse_tokens: bool) -> None:
    other.sampling = replace(
        other.sampling, clean_feet=corrects, join_tokens=corrects, project_root=corrects, plan_root=corrects
    )
    embedding = np.random.default_rng(1).standard_normal(32).astype(np.float32)
    targets = Targets(other.skeleton)
    targets.add_waypoints([30, 90], torch.tensor([[1.5, -1.0], [2.0, 0.5]]))
    constraints = (Waypoint(1, 30, 1.5, -1.0), Waypoint(2, 90, 2.0, 0.5))
    features = expected(other, embedding, targets, reuse_tokens)
    compare(other, stream(other, embedding, constraints, reuse_tokens), features)


def test_built_engine_gives_its_windows_whole_tokens_of_history(other: Model) -> None:
    patch, runner, outputs = other.config.patch, Recording(other, "other"), list[Output]()
    assert usual_history(patch) % patch == 0
    engine = build_engine(
        ServerConfig(history_frames=18, profile_s=0.01, max_rows=1), runner, outputs.extend, lambda report: None
    )
    spec = SessionSpec(
        KEY, 7, "other", Priority.BATCH, lookahead=80, denoise_steps=2, guidance=Guidance(1.0, 0.0), clip_frames=80
    )
    engine.submit(Open(spec, 1, 0.0))
    while not any(isinstance(output, Closed) for output in outputs):
        engine.step()
    assert [len(job.history) for job in runner.begun] == [0, 18 // patch * patch]


def test_partial_token_horizon_and_unequal_patches_are_refused(model: Model) -> None:
    with pytest.raises(ConfigError, match="multiple of 7 frames"):
        with_patch(model.config, 7)
    with pytest.raises(ConfigError, match=r"denoiser\.patch is 5 but the tokenizer's is 4"):
        replace(model.config, denoiser=replace(model.config.denoiser, patch=5))
