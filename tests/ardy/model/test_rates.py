"""Models of other frame rates and patch sizes: how far their windows reach, and that they generate motion."""

from __future__ import annotations

import pytest
import torch

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.config import DenoiserConfig, ModelConfig, PositionMode, TokenizerConfig, TransformerConfig
from motiongen_ardy.model.model import Model, build_model
from motiongen_ardy.model.rollout import RolloutRequest, rollout

RELATIVE: PositionMode = "learned_prefix_zero_at_first_generation"


def make_model(fps: int, patch: int, positions: PositionMode) -> Model:
    torch.manual_seed(0)
    transformer = TransformerConfig(width=16, feed_forward=24, num_layers=1, num_heads=2)
    denoiser = DenoiserConfig(transformer, 4, text_tokens=1, text_dim=3, positions=positions, patch=patch)
    tokenizer = TokenizerConfig(transformer, latent_dim=4, levels=(8,) * 4, patch=patch)
    width = load_skeleton("core27").feature_dim + LOCAL_ROOT_WIDTH
    config = ModelConfig("core27", fps, horizon=2 * patch, denoiser=denoiser, tokenizer=tokenizer)
    return build_model(config, Stats(torch.zeros(width), torch.ones(width))).eval()


@pytest.mark.parametrize("positions", [RELATIVE, "default"])
@pytest.mark.parametrize(
    ("fps", "patch", "longest"), [(1, 4, 8), (20, 4, 200), (25, 4, 248), (60, 1, 509), (240, 4, 2036), (120, 10, 1200)]
)
def test_motion_is_generated_with_a_goal_at_the_end_of_the_longest_window(
    fps: int, patch: int, longest: int, positions: PositionMode
) -> None:
    """A window covers ten seconds, or as far as positions reach; goals further away are ignored until in sight."""
    model = make_model(fps, patch, positions)
    assert model.config.max_window_frames == longest
    targets = Targets(model.skeleton)
    targets.add_waypoints([longest - 1, 100_000], torch.zeros(2, 2))
    features = rollout(model, RolloutRequest(3 * patch, torch.zeros(3), num_steps=1, targets=targets))
    assert features.shape == (3 * patch, model.representation.feature_dim)
    assert features.isfinite().all()
