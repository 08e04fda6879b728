"""Many characters at once for evaluation: windows of equal shape in one batch, on the reference code."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from motiongen_ardy.config import FRAMES_PER_TOKEN
from motiongen_ardy.constraint import Targets
from motiongen_ardy.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model import Model
from motiongen_ardy.noise import window_noise
from motiongen_ardy.rollout import DEFAULT_HISTORY_FRAMES, WindowRequest, generate_window, visible_frames
from motiongen_ardy.tokenizer.model import ROOT_TOKEN_WIDTH


def generate_batch(
    model: Model,
    text: Tensor,
    seeds: Sequence[int],
    num_windows: int,
    num_steps: int,
    history: Tensor | None = None,
    targets: Sequence[Targets] | None = None,
    weights: GuidanceWeights | None = None,
    history_frames: int = DEFAULT_HISTORY_FRAMES,
) -> Tensor:
    """Features in natural units (B, num_windows * horizon, D), the given history not included.

    text: (B, W); history: (B, H, D) normalised, frame 0 of `targets` being its first frame; every row's targets must
    lie at the same frames.
    """
    features = torch.zeros(len(seeds), 0, model.representation.feature_dim) if history is None else history
    given = features.shape[1]
    num_tokens = model.config.horizon // FRAMES_PER_TOKEN
    width = ROOT_TOKEN_WIDTH + model.config.denoiser.latent_dim
    for index in range(num_windows):
        crop = min(features.shape[1], history_frames) // FRAMES_PER_TOKEN * FRAMES_PER_TOKEN
        first = features.shape[1] - crop
        span = crop + model.config.horizon
        observed = mask = None
        if targets is not None:
            span = max(visible_frames(model, crop, one, first) for one in targets)
            pairs = [one.observe(model.representation, first, span) for one in targets]
            observed, mask = (torch.stack(part) for part in zip(*pairs, strict=True))
        request = WindowRequest(
            num_frames=span,
            num_steps=num_steps,
            text=text[:, None],
            noise=torch.stack([window_noise(seed, index, num_tokens, width) for seed in seeds]),
            weights=weights or GuidanceWeights(),
            history=features[:, first:] if crop else None,
            observed=observed,
            mask=mask,
        )
        window = generate_window(model, request)
        features = torch.cat([features, window[:, crop:]], dim=1)
    return model.representation.denormalize(features[:, given:])
