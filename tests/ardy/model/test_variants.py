"""The paper's ablations are configurations of the same code: they build, learn, are saved and generate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, save_checkpoint
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.config import ConfigError
from motiongen_ardy.model.generation import WindowRequest, start_window
from motiongen_ardy.model.model import Model, build_model
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from motiongen_ardy.model.tokenizer import ExplicitBody
from motiongen_ardy.model.window import WindowError
from motiongen_ardy.train.denoiser_loss import DenoiserLoss
from motiongen_ardy.train.windows import TrainingWindows
from tests.ardy.variants import VARIANTS, varied


def make_model(golden: Any, variant: str) -> Model:
    torch.manual_seed(0)
    layout = golden.model.representation
    return build_model(varied(golden.model.config, variant, layout.body_dim), layout.stats).eval()


def make_request(model: Model, num_frames: int) -> RolloutRequest:
    targets = None
    if model.config.denoiser.constraints:
        targets = Targets(model.skeleton)
        targets.add_waypoints([30, 70], torch.tensor([[1.0, 2.0], [1.0, 3.0]]))
    text = torch.randn(model.config.denoiser.text_dim, generator=torch.Generator().manual_seed(2))
    return RolloutRequest(num_frames, text, num_steps=2, targets=targets)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_generates_the_same_after_saving(golden: Any, tmp_path: Path, variant: str) -> None:
    model = make_model(golden, variant)
    request = make_request(model, 60)
    features = rollout(model, request)
    assert features.shape == (60, model.representation.feature_dim)
    assert features.isfinite().all()
    save_checkpoint(model, tmp_path)
    loaded = load_checkpoint(tmp_path)
    assert loaded.config == model.config
    assert torch.equal(rollout(loaded, request), features)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_learns(golden: Any, variant: str) -> None:
    """A few training steps on one synthetic batch reduce the loss."""
    model = make_model(golden, variant)
    if model.tokenizer is not None:
        model.tokenizer.requires_grad_(False)
    loss = DenoiserLoss(model).train()
    batch = make_batch(model)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-3)
    totals = []
    for _ in range(12):
        torch.manual_seed(1)  # the same noise levels and noise each time, so that the totals compare
        optimizer.zero_grad()
        total, _ = loss(batch)
        total.backward()
        optimizer.step()
        totals.append(total.item())
    assert totals[-1] < 0.95 * totals[0]


def make_batch(model: Model) -> TrainingWindows:
    layout, horizon = model.representation, model.config.horizon
    num_frames = horizon + 16
    phase = torch.linspace(0, 6, num_frames)[None, :, None] + torch.arange(2)[:, None, None]
    features = torch.sin(phase * (1 + torch.arange(layout.feature_dim) % 3)) * 0.8
    mask = torch.zeros_like(features)
    if model.config.denoiser.constraints:
        mask[:, [20, -2], :3] = 1
    return TrainingWindows(
        features=features,
        history_len=torch.tensor([8, 4]),
        generation_len=torch.full((2,), horizon),
        length=torch.full((2,), num_frames),
        num_known=8 + horizon,
        exact=torch.ones(2, dtype=torch.bool),
        observed=features * mask,
        mask=mask,
        text=torch.ones(2, 1, model.config.denoiser.text_dim),
        heading=torch.zeros(2),
    )


def test_explicit_tokens_hold_the_frames_themselves(golden: Any) -> None:
    codec = ExplicitBody(golden.model.representation, 4)
    features = torch.randn(2, 12, golden.model.representation.feature_dim)
    tokens = codec.to_hybrid(features)
    assert tokens.shape == (2, 3, 20 + codec.latent_dim)
    assert torch.equal(codec.from_hybrid(tokens, torch.tensor([12, 12])), features)
    valid = torch.arange(12)[None] < torch.tensor([[12], [7]])
    assert not codec.to_hybrid(features, valid)[1, 1:, 20:].any()


def test_explicit_latents_must_be_as_wide_as_the_frames(golden: Any) -> None:
    config = replace(golden.model.config, tokenizer=None)
    with pytest.raises(ConfigError, match="without a tokenizer it must be"):
        build_model(config, golden.model.representation.stats)


def test_a_model_without_goal_inputs_refuses_constraints(golden: Any) -> None:
    model = make_model(golden, "no goals")
    horizon, layout = model.config.horizon, model.representation
    goals = torch.zeros(1, horizon, layout.feature_dim)
    noise = torch.zeros(1, horizon // 4, 20 + model.config.denoiser.latent_dim)
    text = torch.zeros(1, 1, model.config.denoiser.text_dim)
    with pytest.raises(WindowError, match="without goal inputs"):
        start_window(model, WindowRequest(horizon, 2, text, noise, observed=goals, mask=goals))
