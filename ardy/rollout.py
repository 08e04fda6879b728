"""One character, one loop, no tricks: the reference that the serving engine must equal.

A window is `start_window`, `num_steps` times `denoise_step`, `finish_window`. `rollout` repeats that with the history
re-encoded from explicit features each time; `generate_clip` keeps the tokens instead and decodes at the end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ardy.config import FRAMES_PER_TOKEN
from ardy.constraint import Targets
from ardy.denoiser.guidance import GuidanceWeights, PassBatch, batch_passes, full_passes, guided_prediction
from ardy.diffusion import cosine_schedule
from ardy.model import Model
from ardy.noise import window_noise
from ardy.representation import ROOT_WIDTH, Representation
from ardy.tokenizer import Tokenizer
from ardy.tokenizer.model import ROOT_TOKEN_WIDTH, root_from_tokens, root_to_tokens
from ardy.window import Window

DEFAULT_HISTORY_FRAMES = 16


@dataclass(frozen=True)
class WindowRequest:
    """One window of B rows that share history length, horizon and step count.

    num_frames: history, horizon and visible future, a multiple of 4. noise: (B, G/4, 20 + L), standard normal.
    text: (B, n, W), zeros for no text. history: (B, H, D) normalised features in the world frame, or None.
    translation: (B, 3) with y = 0, metres, and heading: (B) radians, where a first window starts (with history they
    follow from it). observed, mask: (B, num_frames, D), normalised, in the world frame; frame 0 is the first of history.
    """

    num_frames: int
    num_steps: int
    text: Tensor
    noise: Tensor
    weights: GuidanceWeights = GuidanceWeights()
    history: Tensor | None = None
    translation: Tensor | None = None
    heading: Tensor | None = None
    observed: Tensor | None = None
    mask: Tensor | None = None


@dataclass(frozen=True)
class WindowState:
    """A window between two denoising steps. tokens: (B, N, 20 + L), history clean; translation: (B, 3) metres."""

    tokens: Tensor
    window: Window
    translation: Tensor
    passes: PassBatch


def move_root(layout: Representation, tokens: Tensor, offset: Tensor) -> Tensor:
    """Hybrid tokens (B, N, 20 + L) with their root moved by (B, 3) metres over the ground."""
    root = layout.translate_root(root_from_tokens(tokens), offset)
    return torch.cat([root_to_tokens(root), tokens[..., ROOT_TOKEN_WIDTH:]], dim=-1)


def local_goals(
    layout: Representation, observed: Tensor, mask: Tensor, translation: Tensor, history_len: Tensor
) -> tuple[Tensor, Tensor]:
    """Constraints (B, T, D) of the world frame in the window's own frame, and none in the history."""
    frames = torch.arange(mask.shape[1], device=mask.device)[None]
    mask = mask * (frames >= history_len[:, None])[..., None]
    root = layout.translate_root(observed[..., :ROOT_WIDTH], -translation)
    return torch.cat([root, observed[..., ROOT_WIDTH:]], dim=-1) * mask, mask


def require_tokenizer(model: Model) -> Tokenizer:
    """The model's tokenizer. Raises ValueError for a model on explicit features, which has none."""
    if model.tokenizer is None:
        raise ValueError("this model denoises explicit features and has no tokenizer; it cannot decode latents")
    return model.tokenizer


def start_window(model: Model, request: WindowRequest) -> WindowState:
    """Encode and recentre the history, bring the constraints into its frame, and lay out the noise."""
    layout, tokenizer = model.representation, require_tokenizer(model)
    batch, device = request.text.shape[0], request.text.device
    width = ROOT_TOKEN_WIDTH + tokenizer.config.latent_dim
    if request.history is not None and request.history.shape[1]:
        history = tokenizer.to_hybrid(request.history)
        history_frames = request.history.shape[1]
        root, translation = layout.recentre(root_from_tokens(history), history_frames - 1)
        history = torch.cat([root_to_tokens(root), history[..., ROOT_TOKEN_WIDTH:]], dim=-1)
        heading = layout.heading_of_root(request.history[:, 0, :ROOT_WIDTH])
    else:
        history = torch.zeros(batch, 0, width, device=device)
        translation = torch.zeros(batch, 3, device=device) if request.translation is None else request.translation
        heading = torch.zeros(batch, device=device) if request.heading is None else request.heading
    return lay_out(model, request, history, translation, heading)


def lay_out(
    model: Model, request: WindowRequest, history: Tensor, translation: Tensor, heading: Tensor
) -> WindowState:
    """The state before the first step, from history tokens (B, N_h, 20 + L) that are already recentred."""
    batch, history_tokens = history.shape[:2]
    num_tokens = request.num_frames // FRAMES_PER_TOKEN
    if history_tokens + request.noise.shape[1] > num_tokens:
        raise ValueError(f"a window of {request.num_frames} frames cannot hold its history and horizon")
    history_len = torch.full((batch,), history_tokens * FRAMES_PER_TOKEN, device=history.device)
    tokens = history.new_zeros(batch, num_tokens, history.shape[-1])
    tokens[:, :history_tokens] = history
    tokens[:, history_tokens : history_tokens + request.noise.shape[1]] = request.noise
    observed, mask = request.observed, request.mask
    if observed is not None and mask is not None:
        observed, mask = local_goals(model.representation, observed, mask, translation, history_len)
    window = Window(
        history_len=history_len,
        generation_len=torch.full_like(history_len, request.noise.shape[1] * FRAMES_PER_TOKEN),
        num_frames=request.num_frames,
        text=request.text,
        heading=heading,
        observed=observed,
        mask=mask,
    )
    passes = batch_passes([full_passes(model.config.guidance, request.weights)] * batch, history.device)
    return WindowState(tokens, window, translation, passes)


def denoise_step(model: Model, state: WindowState, index: int, num_steps: int) -> WindowState:
    """One reverse step; index counts down from num_steps - 1 to 0. History and future tokens do not change."""
    schedule = cosine_schedule(model.config.num_base_steps).to(state.tokens.device)
    rows = torch.full_like(state.window.history_len, index)
    counts = torch.full_like(rows, num_steps)
    base_step = schedule.base_step[counts, rows]
    clean = guided_prediction(model.denoiser, state.tokens, base_step, state.window, state.passes)
    moved = schedule.reverse_step(state.tokens, clean, rows, counts)
    horizon = state.window.generation_tokens[..., None]
    return replace(state, tokens=torch.where(horizon, moved, state.tokens))


def finish_window(model: Model, state: WindowState) -> Tensor:
    """Normalised features (B, H + G, D) in the world frame; the history part is a re-synthesis."""
    tokenizer = require_tokenizer(model)
    lengths = state.window.history_len + state.window.generation_len
    tokens = world_tokens(model, state)
    return tokenizer.from_hybrid(tokens, lengths)


def world_tokens(model: Model, state: WindowState) -> Tensor:
    """The finished hybrid tokens of history and horizon in the world frame, latents snapped to the grid."""
    num_known = int((state.window.history_len + state.window.generation_len).max()) // FRAMES_PER_TOKEN
    return world_tokens_of(model, state.tokens[:, :num_known], state.translation)


def world_tokens_of(model: Model, tokens: Tensor, translation: Tensor) -> Tensor:
    """Hybrid tokens (B, N, 20 + L) moved by (B, 3) metres, their latents snapped to the grid."""
    tokens = move_root(model.representation, tokens, translation)
    latents = require_tokenizer(model).requantize(tokens[..., ROOT_TOKEN_WIDTH:])
    return torch.cat([tokens[..., :ROOT_TOKEN_WIDTH], latents], dim=-1)


@torch.no_grad()
def generate_window(model: Model, request: WindowRequest) -> Tensor:
    """One whole window: normalised features (B, H + G, D) in the world frame."""
    state = start_window(model, request)
    for index in reversed(range(request.num_steps)):
        state = denoise_step(model, state, index, request.num_steps)
    return finish_window(model, state)


def visible_frames(model: Model, history_frames: int, targets: Targets | None, first_frame: int) -> int:
    """How long a window must be to see its constraints: history and horizon, or up to the furthest constraint within
    the longest window, in whole tokens. first_frame: the frame at which the window's history starts.
    """
    shortest = history_frames + model.config.horizon
    if targets is None:
        return shortest
    longest = model.config.max_window_frames
    frames = {*targets.ground, *targets.heading, *targets.height, *(frame for frame, _ in targets.positions)}
    ahead = [frame - first_frame + 1 for frame in frames if history_frames <= frame - first_frame < longest]
    needed = -(-max(ahead, default=0) // FRAMES_PER_TOKEN) * FRAMES_PER_TOKEN
    return max(shortest, min(needed, longest))


@torch.no_grad()
def rollout(
    model: Model,
    text: Tensor,
    num_frames: int,
    seed: int,
    num_steps: int = 10,
    weights: GuidanceWeights | None = None,
    history_frames: int = DEFAULT_HISTORY_FRAMES,
    targets: Targets | None = None,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Tensor:
    """Normalised features (num_frames, D) of one character, window after window.

    text: (W), zeros for no text. start: x and z in metres and heading in radians. history_frames: how many decided
    frames each later window starts with, a multiple of 4. The k-th window starts from `window_noise(seed, k)`.
    """
    features = torch.zeros(0, model.representation.feature_dim)
    num_tokens = model.config.horizon // FRAMES_PER_TOKEN
    width = ROOT_TOKEN_WIDTH + model.config.denoiser.latent_dim
    window_index = 0
    while len(features) < num_frames:
        history = features[max(0, len(features) - history_frames) :]
        first_frame = len(features) - len(history)
        span = visible_frames(model, len(history), targets, first_frame)
        observed, mask = (None, None)
        if targets is not None:
            observed, mask = (part[None] for part in targets.observe(model.representation, first_frame, span))
        request = WindowRequest(
            num_frames=span,
            num_steps=num_steps,
            text=text[None, None],
            noise=window_noise(seed, window_index, num_tokens, width)[None],
            weights=weights or GuidanceWeights(),
            history=history[None] if len(history) else None,
            translation=torch.tensor([[start[0], 0.0, start[1]]]),
            heading=torch.tensor([start[2]]),
            observed=observed,
            mask=mask,
        )
        window = generate_window(model, request)[0]
        features = torch.cat([features, window[len(history) :]])
        window_index += 1
    return features[:num_frames]
