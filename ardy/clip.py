"""Many windows in one call, on kept tokens: the form in which a bounded clip is generated."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ardy.config import FRAMES_PER_TOKEN
from ardy.denoiser.guidance import GuidanceWeights
from ardy.model import Model
from ardy.rollout import WindowRequest, denoise_step, lay_out, move_root, require_tokenizer
from ardy.tokenizer.model import ROOT_TOKEN_WIDTH, root_from_tokens, root_to_tokens


@dataclass(frozen=True)
class ClipRequest:
    """A clip of num_frames frames. noise: (windows, B, G/4, 20 + L); text: (B, n, W); heading: (B) radians at the start.

    observed, mask: (B, num_frames, D), normalised, world frame, or None. crop_frames: how much history each window
    sees, a multiple of 4, or None for all of it.
    """

    num_frames: int
    num_steps: int
    text: Tensor
    noise: Tensor
    heading: Tensor
    weights: GuidanceWeights = GuidanceWeights()
    observed: Tensor | None = None
    mask: Tensor | None = None
    crop_frames: int | None = None


def _padded(constraints: Tensor | None, total: int, start: int) -> Tensor | None:
    if constraints is None:
        return None
    missing = total - constraints.shape[1]
    return torch.nn.functional.pad(constraints, (0, 0, 0, max(0, missing)))[:, start:total]


@torch.no_grad()
def generate_clip(model: Model, request: ClipRequest) -> Tensor:
    """Normalised features (B, num_frames, D) in the world frame.

    Every window sees all constraints after it. After a window all tokens so far are recentred at the newest frame and
    snapped to the grid. Without a crop the tokens are decoded in one go, with a crop window by window.
    """
    layout, tokenizer, horizon = model.representation, require_tokenizer(model), model.config.horizon
    batch, device = request.text.shape[0], request.text.device
    num_windows = -(-request.num_frames // horizon)
    total = num_windows * horizon
    crop = total if request.crop_frames is None else request.crop_frames
    tokens = torch.zeros(batch, 0, ROOT_TOKEN_WIDTH + tokenizer.config.latent_dim, device=device)
    translation = torch.zeros(batch, 3, device=device)
    heading = request.heading
    for index in range(num_windows):
        done = index * horizon
        start = max(0, done - crop)
        window_request = WindowRequest(
            num_frames=total - start,
            num_steps=request.num_steps,
            text=request.text,
            noise=request.noise[index],
            weights=request.weights,
            observed=_padded(request.observed, total, start),
            mask=_padded(request.mask, total, start),
        )
        history = tokens[:, start // FRAMES_PER_TOKEN :]
        state = lay_out(model, window_request, history, translation, heading)
        for step in reversed(range(request.num_steps)):
            state = denoise_step(model, state, step, request.num_steps)
        new = state.tokens[:, history.shape[1] : history.shape[1] + horizon // FRAMES_PER_TOKEN]
        tokens = torch.cat([tokens, new], dim=1)
        root, centre = layout.recentre(root_from_tokens(tokens), done + horizon - 1)
        tokens = torch.cat([root_to_tokens(root), tokenizer.requantize(tokens[..., ROOT_TOKEN_WIDTH:])], dim=-1)
        translation = translation + centre
        if request.crop_frames is not None:
            heading = layout.heading_of_root(root[:, max(0, done + horizon - crop)])
    tokens = move_root(layout, tokens, translation)
    return _decode(model, request, tokens, horizon)[:, : request.num_frames]


def _decode(model: Model, request: ClipRequest, tokens: Tensor, horizon: int) -> Tensor:
    tokenizer = require_tokenizer(model)
    batch, wanted = tokens.shape[0], -(-request.num_frames // FRAMES_PER_TOKEN) * FRAMES_PER_TOKEN

    def decode(first: int, end: int) -> Tensor:
        """Features of tokens first..end-1, decoded on their own."""
        frames = torch.arange(first * FRAMES_PER_TOKEN, end * FRAMES_PER_TOKEN, device=tokens.device)
        valid = (frames < wanted)[None].expand(batch, -1)
        return tokenizer.from_hybrid(tokens[:, first:end], valid.sum(1), valid)

    if request.crop_frames is None:
        return decode(0, tokens.shape[1])
    size, crop = horizon // FRAMES_PER_TOKEN, request.crop_frames // FRAMES_PER_TOKEN
    parts = [
        decode(max(0, first - crop), first + size)[:, -horizon:] for first in range(0, tokens.shape[1], size)
    ]
    return torch.cat(parts, dim=1)


