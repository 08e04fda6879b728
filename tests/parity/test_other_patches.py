"""Models with other patches: sessions match rollouts, corrected and not, and an engine can be built for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.config import ConfigError, ModelConfig
from motiongen_ardy.model.model import Model, build_model
from motiongen_ardy.model.rollout import usual_history
from motiongen_server.config import ServerConfig
from motiongen_server.engine.types import Waypoint
from motiongen_server.engine_process.model_loading import build_engine
from motiongen_server.runner import TorchRunner
from tests.parity.test_streamed_equals_rollout import compare, expected, stream

PATCHES = (1, 5, 8)


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


def test_history_is_rounded_to_whole_tokens_and_an_engine_can_be_built(other: Model) -> None:
    patch = other.config.patch
    runner = TorchRunner(other, "other")
    assert (runner.facts.patch, runner.facts.whole_patches(18)) == (patch, max(1, 18 // patch) * patch)
    engine = build_engine(
        ServerConfig(history_frames=18, profile_s=0.01), runner, lambda outputs: None, lambda report: None
    )
    assert engine is not None
    assert usual_history(patch) % patch == 0


def test_partial_token_horizon_and_unequal_patches_are_refused(model: Model) -> None:
    with pytest.raises(ConfigError, match="multiple of 7 frames"):
        with_patch(model.config, 7)
    with pytest.raises(ConfigError, match=r"denoiser\.patch is 5 but the tokenizer's is 4"):
        replace(model.config, denoiser=replace(model.config.denoiser, patch=5))
