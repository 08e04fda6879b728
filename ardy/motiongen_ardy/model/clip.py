"""Many windows in one call, on kept tokens: the form in which a bounded clip is generated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.config import FRAMES_PER_TOKEN
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.rollout import (
    WindowRequest,
    WindowState,
    commit_window,
    denoise_step,
    denoise_window,
    finish_window,
    lay_out,
    move_root,
    recentre_tokens,
)
from motiongen_ardy.model.sampling.plan import plan_observed
from motiongen_ardy.model.tokenizer.model import ROOT_TOKEN_WIDTH, root_from_tokens
from motiongen_ardy.model.window import WindowError


@dataclass(frozen=True)
class ClipRequest:
    """A clip of num_frames frames in windows of the model's horizon.

    noise: (windows, B, G/4, 20 + L); text: (B, n, W). heading: (B) radians at the start, or history: (B, H, D)
    normalised features that the clip goes on from, counted in num_frames. observed, mask: (B, num_frames, D),
    normalised, world frame, or None. crop_frames: how much history a window sees, a multiple of 4, None for all of it.
    lengths: (B) frames that each row is to have, num_frames if absent; rows go on past theirs with unusable frames.
    """

    num_frames: int
    num_steps: int
    text: Tensor
    noise: Tensor
    heading: Tensor | None = None
    history: Tensor | None = None
    weights: GuidanceWeights | None = None
    observed: Tensor | None = None
    mask: Tensor | None = None
    crop_frames: int | None = None
    lengths: Tensor | None = None

    def __post_init__(self) -> None:
        if (self.heading is None) == (self.history is None):
            raise WindowError("a clip starts with a heading or with a history; give one of them")
        if self.history is not None and self.crop_frames is not None:
            raise WindowError("a clip that goes on from a history sees all of it; leave out crop_frames")
        for name, frames in (("crop_frames", self.crop_frames), ("history", self.num_history_frames)):
            if frames is not None and (frames < 0 or frames % FRAMES_PER_TOKEN):
                raise WindowError(f"{name} is {frames} frames; give a multiple of {FRAMES_PER_TOKEN}")

    @property
    def num_history_frames(self) -> int:
        return 0 if self.history is None else self.history.shape[1]


@dataclass(frozen=True)
class ClipState:
    """A clip between two windows.

    tokens: (B, N, 20 + L), all so far, recentred at their last frame and on the grid; translation: (B, 3) metres from
    their frame to the world's; heading: (B) radians of the first frame that the next window sees.
    """

    tokens: Tensor
    translation: Tensor
    heading: Tensor

    @property
    def num_frames(self) -> int:
        return self.tokens.shape[1] * FRAMES_PER_TOKEN


def start_clip(model: Model, request: ClipRequest) -> ClipState:
    """The state before the first window."""
    layout = model.representation
    batch, device = request.text.shape[0], request.text.device
    if request.history is not None:
        heading = layout.heading_of_root(request.history[:, 0, :ROOT_WIDTH])
        empty = ClipState(model.codec.to_hybrid(request.history), torch.zeros(batch, 3, device=device), heading)
        return recentred(model, empty)
    assert request.heading is not None
    width = ROOT_TOKEN_WIDTH + model.config.denoiser.latent_dim
    none = torch.zeros(batch, 0, width, device=device)
    return ClipState(none, torch.zeros(batch, 3, device=device), request.heading)


def recentred(model: Model, state: ClipState) -> ClipState:
    """The same clip in the frame of its last frame's root."""
    tokens, centre = recentre_tokens(model.representation, state.tokens)
    return replace(state, tokens=tokens, translation=state.translation + centre)


def _goals_ahead(
    model: Model, request: ClipRequest, start: int, root: Tensor, translation: Tensor, heading: Tensor
) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
    """Observed features, mask and planned frames of the window that begins at frame `start`; None without constraints.

    root: (B, H, 5), normalised, the window's history in the world frame; translation, heading: as of `ClipState`.
    """
    if request.observed is None or request.mask is None:
        return None, None, None
    total = request.num_history_frames + request.noise.shape[0] * model.config.horizon
    observed, mask = (
        functional.pad(part, (0, 0, 0, total - part.shape[1]))[:, start:] for part in (request.observed, request.mask)
    )
    return plan_observed(model, observed, mask, root, translation, heading)


def clip_window(model: Model, request: ClipRequest, state: ClipState, index: int) -> WindowState:
    """The finished window `index` in the frame of `state`. It sees every constraint that is still ahead."""
    horizon = model.config.horizon
    total = request.num_history_frames + request.noise.shape[0] * horizon
    start = 0 if request.crop_frames is None else max(0, state.num_frames - request.crop_frames)

    seen = move_root(model.representation, state.tokens[:, start // FRAMES_PER_TOKEN :], state.translation)
    where = root_from_tokens(seen), state.translation, state.heading
    observed, mask, planned = _goals_ahead(model, request, start, *where)
    window_request = WindowRequest(
        num_frames=total - start,
        num_steps=request.num_steps,
        text=request.text,
        noise=request.noise[index],
        weights=request.weights,
        observed=observed,
        mask=mask,
        planned=planned,
    )
    history = state.tokens[:, start // FRAMES_PER_TOKEN :]
    window = lay_out(model, window_request, history, state.translation, state.heading)
    for step in reversed(range(request.num_steps)):
        window = denoise_step(model, window, step, request.num_steps)
    return window


def append_window(model: Model, request: ClipRequest, state: ClipState, window: WindowState) -> ClipState:
    """The clip with a window's horizon appended."""
    horizon_tokens = model.config.horizon // FRAMES_PER_TOKEN
    first = int(window.window.history_len[0]) // FRAMES_PER_TOKEN
    tokens = torch.cat([state.tokens, window.tokens[:, first : first + horizon_tokens]], dim=1)
    state = recentred(model, replace(state, tokens=tokens))
    root, latents = state.tokens[..., :ROOT_TOKEN_WIDTH], state.tokens[..., ROOT_TOKEN_WIDTH:]
    state = replace(state, tokens=torch.cat([root, model.codec.requantize(latents)], dim=-1))
    if request.crop_frames is None:
        return state
    seen = max(0, state.num_frames - request.crop_frames)
    return replace(state, heading=model.representation.heading_of_root(root_from_tokens(root)[:, seen]))


@torch.no_grad()
def generate_clip(model: Model, request: ClipRequest) -> Tensor:
    """Normalised features (B, num_frames, D) in the world frame.

    Raises WindowError unless there is noise for just the windows that num_frames needs.
    """
    needed = -(-(request.num_frames - request.num_history_frames) // model.config.horizon)
    if request.noise.shape[0] != needed or needed < 1:
        raise WindowError(
            f"noise is for {request.noise.shape[0]} windows; {request.num_frames} frames, of which"
            f" {request.num_history_frames} are history, take {needed}"
        )
    if model.sampling.corrects:
        return _generate_corrected(model, request)[:, : request.num_frames]
    state = start_clip(model, request)
    for index in range(needed):
        state = append_window(model, request, state, clip_window(model, request, state, index))
    return decode_clip(model, request, state)[:, : request.num_frames]


def _generate_corrected(model: Model, request: ClipRequest) -> Tensor:
    """Features (B, T, D) of all windows, each encoding those before it anew: tokens know nothing of corrections."""
    batch, device = request.text.shape[0], request.text.device
    features = torch.zeros(batch, 0, model.representation.feature_dim, device=device)
    if request.history is not None:
        features = request.history
    translation = torch.zeros(batch, 3, device=device)
    heading = torch.zeros(batch, device=device) if request.heading is None else request.heading
    for noise in request.noise:
        start = 0 if request.crop_frames is None else max(0, features.shape[1] - request.crop_frames)
        seen = features[:, start:]
        observed, mask, planned = _goals_ahead(model, request, start, seen[..., :ROOT_WIDTH], translation, heading)
        window = WindowRequest(
            num_frames=request.num_history_frames + request.noise.shape[0] * model.config.horizon - start,
            num_steps=request.num_steps,
            text=request.text,
            noise=noise,
            weights=request.weights,
            history=seen,
            heading=heading,
            observed=observed,
            mask=mask,
            planned=planned,
        )
        finished = finish_window(model, denoise_window(model, window))
        features = torch.cat([features, commit_window(model, window, finished)], dim=1)
    return features


def decode_clip(model: Model, request: ClipRequest, state: ClipState) -> Tensor:
    """Normalised features of all tokens, in one go without a crop, window by window with one."""
    tokens = move_root(model.representation, state.tokens, state.translation)
    wanted = request.lengths
    if wanted is None:
        wanted = torch.full(tokens.shape[:1], request.num_frames, device=tokens.device)
    wanted = -(-wanted // FRAMES_PER_TOKEN) * FRAMES_PER_TOKEN

    def decode(first: int, end: int) -> Tensor:
        """Features of tokens first..end-1, decoded on their own."""
        frames = torch.arange(first * FRAMES_PER_TOKEN, end * FRAMES_PER_TOKEN, device=tokens.device)
        valid = frames < wanted[:, None]
        return model.codec.from_hybrid(tokens[:, first:end], valid.sum(1), valid)

    if request.crop_frames is None:
        return decode(0, tokens.shape[1])
    horizon = model.config.horizon
    size, crop = horizon // FRAMES_PER_TOKEN, request.crop_frames // FRAMES_PER_TOKEN
    parts = [decode(max(0, first - crop), first + size)[:, -horizon:] for first in range(0, tokens.shape[1], size)]
    return torch.cat(parts, dim=1)
