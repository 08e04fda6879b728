"""One character, one loop, no tricks: the reference that the serving engine must equal.

A window is `start_window`, `num_steps` times `denoise_step`, `finish_window`. `rollout` repeats that with the history
re-encoded from explicit features each time, or on request with its tokens kept where they fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count, pairwise

import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.config import FRAMES_PER_TOKEN
from motiongen_ardy.model.denoiser.blocks import MAX_TOKENS
from motiongen_ardy.model.denoiser.guidance import (
    GuidanceWeights,
    PassBatch,
    batch_passes,
    full_passes,
    guided_prediction,
)
from motiongen_ardy.model.diffusion import cosine_schedule
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.noise import window_noise
from motiongen_ardy.model.sampling.correct import correct_window
from motiongen_ardy.model.sampling.plan import plan_targets, plan_text
from motiongen_ardy.model.sampling.projection import make_projection
from motiongen_ardy.model.token_history import TokenHistory
from motiongen_ardy.model.tokenizer.model import ROOT_TOKEN_WIDTH, root_from_tokens, root_to_tokens
from motiongen_ardy.model.window import Window, WindowError

DEFAULT_HISTORY_FRAMES = 16


@dataclass(frozen=True)
class WindowRequest:
    """One window of B rows that share history length, horizon and step count.

    num_frames: history, horizon and visible future, a multiple of 4. noise: (B, G/4, 20 + L), standard normal.
    text: (B, n, W), zeros for no text. history: (B, H, D) normalised features in the world frame, or None.
    history_tokens: (B, H / 4, 20 + L) in the world frame, the tokens of `history` where they are known.
    translation: (B, 3) with y = 0, metres, and heading: (B) radians, where a first window starts (with history they
    follow from it). weights: the model's own where None.
    observed, mask: (B, num_frames, D), normalised, in the world frame, from the first of history on. planned: (B,
    num_frames, 2) bool, frames whose observed ground position and heading nobody asked for; None for none.
    """

    num_frames: int
    num_steps: int
    text: Tensor
    noise: Tensor
    weights: GuidanceWeights | None = None
    history: Tensor | None = None
    history_tokens: Tensor | None = None
    translation: Tensor | None = None
    heading: Tensor | None = None
    observed: Tensor | None = None
    mask: Tensor | None = None
    planned: Tensor | None = None


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


def recentre_tokens(layout: Representation, tokens: Tensor) -> tuple[Tensor, Tensor]:
    """Hybrid tokens (B, N, 20 + L) about the root of their last frame, and that centre (B, 3) in metres."""
    root = root_from_tokens(tokens)
    root, centre = layout.recentre(root, root.shape[1] - 1)
    return torch.cat([root_to_tokens(root), tokens[..., ROOT_TOKEN_WIDTH:]], dim=-1), centre


def local_goals(
    layout: Representation, observed: Tensor, mask: Tensor, translation: Tensor, history_len: Tensor
) -> tuple[Tensor, Tensor]:
    """Constraints (B, T, D) of the world frame in the window's own frame, and none in the history."""
    frames = torch.arange(mask.shape[1], device=mask.device)[None]
    mask = mask * (frames >= history_len[:, None])[..., None]
    root = layout.translate_root(observed[..., :ROOT_WIDTH], -translation)
    return torch.cat([root, observed[..., ROOT_WIDTH:]], dim=-1) * mask, mask


def start_window(model: Model, request: WindowRequest) -> WindowState:
    """Encode and recentre the history, bring the constraints into its frame, and lay out the noise.

    Raises WindowError as `lay_out` does, and for a history that is not made of whole tokens.
    """
    layout = model.representation
    batch, device = request.text.shape[0], request.text.device
    width = ROOT_TOKEN_WIDTH + model.config.denoiser.latent_dim
    if request.history is not None and request.history.shape[1]:
        history_frames = request.history.shape[1]
        if history_frames % FRAMES_PER_TOKEN:
            raise WindowError(f"history has {history_frames} frames; give a multiple of {FRAMES_PER_TOKEN}")
        history = model.codec.to_hybrid(request.history) if request.history_tokens is None else request.history_tokens
        history, translation = recentre_tokens(layout, history)
        heading = layout.heading_of_root(request.history[:, 0, :ROOT_WIDTH])
    else:
        history = torch.zeros(batch, 0, width, device=device)
        translation = torch.zeros(batch, 3, device=device) if request.translation is None else request.translation
        heading = torch.zeros(batch, device=device) if request.heading is None else request.heading
    return lay_out(model, request, history, translation, heading)


def weights_of(model: Model, asked: GuidanceWeights | None) -> GuidanceWeights:
    """The weights that are asked for, or the model's own."""
    own = model.sampling.guidance
    return GuidanceWeights(own.text, own.constraint) if asked is None else asked


def check_request(model: Model, request: WindowRequest) -> None:
    """Raise WindowError for what the model cannot do."""
    config = model.config
    if not 1 <= request.num_steps <= config.num_base_steps:
        raise WindowError(f"num_steps is {request.num_steps}; this model takes 1 to {config.num_base_steps}")
    if request.num_frames > MAX_TOKENS * FRAMES_PER_TOKEN:
        raise WindowError(f"the window has {request.num_frames} frames; at most {MAX_TOKENS * FRAMES_PER_TOKEN} fit")
    if request.mask is not None and not config.denoiser.constraints:
        raise WindowError("this model was built without goal inputs; leave out observed and mask")


def lay_out(model: Model, request: WindowRequest, history: Tensor, translation: Tensor, heading: Tensor) -> WindowState:
    """The state before the first step, from history tokens (B, N_h, 20 + L) that are already recentred.

    translation: (B, 3) metres from the window's frame to the world's; heading: (B) radians of the first frame.
    Raises WindowError when history and horizon do not fit, for a step count the model was not trained for, and for
    constraints given to a model without goal inputs.
    """
    check_request(model, request)
    batch, history_tokens = history.shape[:2]
    num_tokens = request.num_frames // FRAMES_PER_TOKEN
    if history_tokens + request.noise.shape[1] > num_tokens:
        needed = (history_tokens + request.noise.shape[1]) * FRAMES_PER_TOKEN
        raise WindowError(f"the window has {request.num_frames} frames; history and horizon alone need {needed}")
    history_len = torch.full((batch,), history_tokens * FRAMES_PER_TOKEN, device=history.device)
    tokens = history.new_zeros(batch, num_tokens, history.shape[-1])
    tokens[:, :history_tokens] = history
    tokens[:, history_tokens : history_tokens + request.noise.shape[1]] = request.noise
    observed, mask, projection = request.observed, request.mask, None
    if observed is not None and mask is not None:
        observed, mask = local_goals(model.representation, observed, mask, translation, history_len)
        if model.sampling.project_root:
            first, count = history_tokens * FRAMES_PER_TOKEN, request.noise.shape[1] * FRAMES_PER_TOKEN
            projection = make_projection(
                model.representation, observed, mask, request.planned, first, count, model.sampling
            )
    window = Window(
        history_len=history_len,
        generation_len=torch.full_like(history_len, request.noise.shape[1] * FRAMES_PER_TOKEN),
        num_frames=request.num_frames,
        text=request.text,
        heading=heading,
        observed=observed,
        mask=mask,
        projection=projection,
    )
    group = full_passes(model.sampling.guidance.mode, weights_of(model, request.weights))
    passes = batch_passes([group] * batch, history.device)
    return WindowState(tokens, window, translation, passes)


def denoise_step(model: Model, state: WindowState, index: int, num_steps: int) -> WindowState:
    """One reverse step; index counts down from num_steps - 1 to 0. History and future tokens do not change."""
    schedule = cosine_schedule(model.config.num_base_steps).to(state.tokens.device)
    rows = torch.full_like(state.window.history_len, index)
    counts = torch.full_like(rows, num_steps)
    base_step = schedule.base_step[counts, rows]
    window = state.window
    if index >= model.sampling.projection.last_steps:
        window = replace(window, projection=None)
    clean = guided_prediction(model.denoiser, state.tokens, base_step, window, state.passes)
    moved = schedule.reverse_step(state.tokens, clean, rows, counts)
    horizon = state.window.generation_tokens[..., None]
    return replace(state, tokens=torch.where(horizon, moved, state.tokens))


def finish_window(model: Model, state: WindowState) -> Tensor:
    """Normalised features (B, H + G, D) in the world frame; the history part is a re-synthesis."""
    lengths = state.window.history_len + state.window.generation_len
    return model.codec.from_hybrid(world_tokens(model, state), lengths)


def world_tokens(model: Model, state: WindowState) -> Tensor:
    """The finished hybrid tokens of history and horizon in the world frame, latents snapped to the grid."""
    num_known = int((state.window.history_len + state.window.generation_len).max()) // FRAMES_PER_TOKEN
    return world_tokens_of(model, state.tokens[:, :num_known], state.translation)


def world_tokens_of(model: Model, tokens: Tensor, translation: Tensor) -> Tensor:
    """Hybrid tokens (B, N, 20 + L) moved by (B, 3) metres, their latents snapped to the grid."""
    tokens = move_root(model.representation, tokens, translation)
    latents = model.codec.requantize(tokens[..., ROOT_TOKEN_WIDTH:])
    return torch.cat([tokens[..., :ROOT_TOKEN_WIDTH], latents], dim=-1)


@torch.no_grad()
def denoise_window(model: Model, request: WindowRequest) -> WindowState:
    """One whole window after its last step."""
    state = start_window(model, request)
    for index in reversed(range(request.num_steps)):
        state = denoise_step(model, state, index, request.num_steps)
    return state


def commit_window(model: Model, request: WindowRequest, finished: Tensor) -> Tensor:
    """The horizon of a finished window as it is to be played: normalised features (B, G, D) in the world frame, with
    what the model's sampling options correct. finished: (B, H + G, D), as `finish_window`.
    """
    end = finished.shape[1]
    start = end - request.noise.shape[1] * FRAMES_PER_TOKEN
    history = finished[:, :0] if request.history is None else request.history
    goals = None
    if request.observed is not None and request.mask is not None:
        goals = request.observed[:, start:end], request.mask[:, start:end]
    return correct_window(model.representation, history, finished[:, start:], goals, model.sampling)


@torch.no_grad()
def generate_window(model: Model, request: WindowRequest) -> Tensor:
    """One whole window: normalised features (B, H + G, D) in the world frame; of the history a re-synthesis, of the
    horizon what `commit_window` makes of it.
    """
    finished = finish_window(model, denoise_window(model, request))
    committed = commit_window(model, request, finished)
    return torch.cat([finished[:, : -committed.shape[1]], committed], dim=1)


def visible_frames(model: Model, history_frames: int, targets: Targets | None, first_frame: int) -> int:
    """How long a window must be to see its constraints: history and horizon, or up to the furthest constraint within
    the longest window, in whole tokens. first_frame: the frame at which the window's history starts.
    """
    shortest = history_frames + model.config.horizon
    if targets is None:
        return shortest
    longest = model.config.max_window_frames
    ahead = [frame - first_frame + 1 for frame in targets.frames if history_frames <= frame - first_frame < longest]
    needed = -(-max(ahead, default=0) // FRAMES_PER_TOKEN) * FRAMES_PER_TOKEN
    return max(shortest, min(needed, longest))


@dataclass(frozen=True)
class RolloutRequest:
    """One character's motion, num_frames long.

    text: (W) or (n, W), zeros for no text. later_text: (first frame, text) of the prompts that follow, in order of
    time; a window that would run across a prompt's first frame is kept only up to it.
    seed: the k-th window starts from `window_noise(seed, k)`. history_frames: the most decided frames that a window
    starts with, a multiple of 4; reuse_tokens: a history that whole tokens of earlier windows cover is not encoded
    again, unless windows are corrected, which their tokens do not know. targets: constraints by absolute frame. start:
    x and z in metres, heading in radians. keep_prompts: they hold whatever the targets ask of the root, though the
    model's own sampling would tell windows a gait's where it contradicts them.
    """

    num_frames: int
    text: Tensor
    seed: int = 0
    num_steps: int = 10
    weights: GuidanceWeights | None = None
    history_frames: int = DEFAULT_HISTORY_FRAMES
    reuse_tokens: bool = False
    targets: Targets | None = None
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    later_text: tuple[tuple[int, Tensor], ...] = ()
    keep_prompts: bool = False

    def __post_init__(self) -> None:
        if self.history_frames < FRAMES_PER_TOKEN or self.history_frames % FRAMES_PER_TOKEN:
            raise WindowError(
                f"history_frames is {self.history_frames}; give a positive multiple of {FRAMES_PER_TOKEN}"
            )
        changes = [FRAMES_PER_TOKEN - 1, *(frame for frame, _ in self.later_text)]
        if any(later <= earlier for earlier, later in pairwise(changes)):
            raise WindowError(f"later_text starts at frames {changes[1:]}; they must rise, the first from 4 on")

    def prompt_at(self, frame: int) -> tuple[Tensor, int]:
        """The text (n, W) that holds at a frame, and the frame at which the next one starts (num_frames if none)."""
        text, end = self.text, self.num_frames
        for first, later in self.later_text:
            if first > frame:
                return torch.atleast_2d(text), min(first, end)
            text = later
        return torch.atleast_2d(text), end


@torch.no_grad()
def rollout(model: Model, request: RolloutRequest) -> Tensor:
    """Normalised features (num_frames, D) in the world frame, window after window."""
    layout, horizon = model.representation, model.config.horizon
    device = layout.stats.mean.device
    width = ROOT_TOKEN_WIDTH + model.config.denoiser.latent_dim
    x, z, heading = request.start
    features = torch.zeros(0, layout.feature_dim, device=device)
    kept = TokenHistory()
    for window_index in count():
        done = len(features)
        if done >= request.num_frames:
            return features
        history_len = min(request.history_frames, done // FRAMES_PER_TOKEN * FRAMES_PER_TOKEN)
        first_frame = done - history_len
        text, text_end = request.prompt_at(done)
        targets = plan_targets(model, request.targets, features[first_frame:], done, request.start)
        if not request.keep_prompts:
            text, led_to = plan_text(model, text, targets, features[first_frame:], done, request.start)
            text_end = text_end if led_to is None else min(text_end, led_to)
        span = visible_frames(model, history_len, targets, first_frame)
        observed, mask, planned = (None, None, None)
        if targets is not None:
            observed, mask = (part[None] for part in targets.observe(layout, first_frame, span))
            planned = targets.planned_frames(first_frame, span)[None].to(device)
        known = kept.before(done, history_len) if request.reuse_tokens else None
        window = WindowRequest(
            num_frames=span,
            num_steps=request.num_steps,
            text=text[None].to(device),
            noise=window_noise(request.seed, window_index, horizon // FRAMES_PER_TOKEN, width)[None].to(device),
            weights=request.weights,
            history=features[None, first_frame:] if history_len else None,
            history_tokens=None if known is None else known[None],
            translation=torch.tensor([[x, 0.0, z]], device=device),
            heading=torch.tensor([heading], device=device),
            observed=observed,
            mask=mask,
            planned=planned,
        )
        state = denoise_window(model, window)
        new = commit_window(model, window, finish_window(model, state))[0]
        if not model.sampling.corrects:  # tokens know nothing of what is corrected after them
            kept.replace_from(done, world_tokens(model, state)[0, history_len // FRAMES_PER_TOKEN :])
        features = torch.cat([features, new[: text_end - done]])
