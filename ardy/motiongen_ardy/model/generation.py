"""One window, step by step: `start_window`, `num_steps` times `denoise_step`, `finish_window`, `commit_window`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.config import MAX_TOKENS
from motiongen_ardy.model.denoiser.guidance import (
    GuidanceWeights,
    PassBatch,
    batch_passes,
    full_passes,
    guided_prediction,
)
from motiongen_ardy.model.diffusion import cosine_schedule
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.correct import correct_window
from motiongen_ardy.model.sampling.projection import free_projection, make_projection
from motiongen_ardy.model.sampling.slowing import motion_before
from motiongen_ardy.model.tokenizer.model import by_token, root_from_tokens
from motiongen_ardy.model.window import KeptRoots, Window, WindowError


@dataclass(frozen=True)
class WindowRequest:
    """One window for B rows that share history length, horizon and step count. P: frames per token.

    num_frames: history, horizon and visible future, a multiple of P. text: (B, n, W), zeros for no text.
    noise: (B, G / P, 5P + L), standard normal. weights: guidance; None: the model's own.
    history: (B, H, D), normalised features in the world frame, or None.
    history_tokens: (B, H / P, 5P + L), in the world frame, the tokens of `history` if they are known.
    translation: (B, 3), metres, y = 0; heading: (B), radians: where a window without history starts.
    observed, mask: (B, num_frames, D), normalised, in the world frame, from the first history frame on.
    planned: (B, num_frames, 2) bool, frames whose observed ground position, or heading, was not asked for itself.
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

    @property
    def history_frames(self) -> int:
        return 0 if self.history is None else self.history.shape[1]


ROW_TENSORS = (
    "text", "noise", "history", "history_tokens", "translation", "heading", "observed", "mask", "planned",
)  # fmt: skip


def stack_windows(windows: Sequence[WindowRequest]) -> WindowRequest:
    """Concatenate the rows of windows that share their shape and settings."""
    rows: dict[str, Tensor] = {}
    for name in ROW_TENSORS:
        parts = [part for window in windows if (part := getattr(window, name)) is not None]
        if parts:
            rows[name] = torch.cat(parts)
    return replace(windows[0], **rows)


@dataclass(frozen=True)
class WindowState:
    """A window between two denoising steps. tokens: (B, N, 5P + L), history clean; translation: (B, 3) metres.

    root: (B, N, 5P), the clean root that the last step predicted; None before the first.
    """

    tokens: Tensor
    window: Window
    translation: Tensor
    passes: PassBatch
    root: Tensor | None = None


def move_root(model: Model, tokens: Tensor, offset: Tensor) -> Tensor:
    """Hybrid tokens (B, N, 5P + L) with their root moved by (B, 3) metres over the ground."""
    root = model.representation.translate_root(root_from_tokens(tokens, model.config.patch), offset)
    return _with_root(model, tokens, root)


def recentre_tokens(model: Model, tokens: Tensor) -> tuple[Tensor, Tensor]:
    """Hybrid tokens (B, N, 5P + L) relative to the root of their last frame, and that centre (B, 3) in metres."""
    root = root_from_tokens(tokens, model.config.patch)
    root, centre = model.representation.recentre(root, root.shape[1] - 1)
    return _with_root(model, tokens, root), centre


def _with_root(model: Model, tokens: Tensor, root: Tensor) -> Tensor:
    """Hybrid tokens (B, N, 5P + L) with their root replaced by (B, PN, 5)."""
    latents = tokens[..., model.config.denoiser.root_token_width :]
    return torch.cat([by_token(root, model.config.patch), latents], dim=-1)


def local_goals(
    layout: Representation, observed: Tensor, mask: Tensor, translation: Tensor, history_len: Tensor
) -> tuple[Tensor, Tensor]:
    """World-frame constraints (B, T, D) moved into the window's own frame; those within the history are dropped."""
    frames = torch.arange(mask.shape[1], device=mask.device)[None]
    mask = mask * (frames >= history_len[:, None])[..., None]
    root = layout.translate_root(observed[..., :ROOT_WIDTH], -translation)
    return torch.cat([root, observed[..., ROOT_WIDTH:]], dim=-1) * mask, mask


def start_window(model: Model, request: WindowRequest) -> WindowState:
    """Encode and recentre the history, move the constraints into its frame, and lay out the noise.

    Raises WindowError as `check_request` and `lay_out` do, and for a history that is not made of whole tokens.
    """
    check_request(model, request)
    layout, patch = model.representation, model.config.patch
    batch = request.text.shape[0]
    if request.history is not None and request.history.shape[1]:
        history_frames = request.history.shape[1]
        if history_frames % patch:
            raise WindowError(f"history has {history_frames} frames; give a multiple of {patch}")
        history = model.codec.to_hybrid(request.history) if request.history_tokens is None else request.history_tokens
        history, translation = recentre_tokens(model, history)
        heading = layout.heading_of_root(request.history[:, 0, :ROOT_WIDTH])
    else:
        history = request.noise.new_zeros(batch, 0, model.config.token_width)
        translation = request.noise.new_zeros(batch, 3) if request.translation is None else request.translation
        heading = request.noise.new_zeros(batch) if request.heading is None else request.heading
    return lay_out(model, request, history, translation, heading)


def weights_of(model: Model, asked: GuidanceWeights | None) -> GuidanceWeights:
    """The requested weights, or else the model's own."""
    own = model.sampling.guidance
    return GuidanceWeights(own.text, own.constraint) if asked is None else asked


def check_request(model: Model, request: WindowRequest) -> None:
    """Raise WindowError for a step count that the model was not trained for, for more frames than it has positions for,
    for constraints given to a model without constraint inputs, and for shapes that do not match.
    """
    config = model.config
    if not 1 <= request.num_steps <= config.num_base_steps:
        raise WindowError(f"num_steps is {request.num_steps}; this model takes 1 to {config.num_base_steps}")
    if request.num_frames > MAX_TOKENS * config.patch:
        raise WindowError(f"the window has {request.num_frames} frames; at most {MAX_TOKENS * config.patch} fit")
    if request.mask is not None and not config.denoiser.constraints:
        raise WindowError("this model was built without goal inputs; leave out observed and mask")
    rows, frames, features = len(request.text), request.num_frames, model.representation.feature_dim
    shapes: dict[str, tuple[int | None, ...]] = {
        "text": (rows, None, config.denoiser.text_dim), "noise": (rows, None, config.token_width),
        "history": (rows, None, features), "history_tokens": (rows, None, config.token_width),
        "translation": (rows, 3), "heading": (rows,),
        "observed": (rows, frames, features), "mask": (rows, frames, features), "planned": (rows, frames, 2),
    }  # fmt: skip
    for name, wanted in shapes.items():
        given = getattr(request, name)
        if given is not None and not _fits(tuple(given.shape), wanted):
            said = ", ".join("n" if length is None else str(length) for length in wanted)
            raise WindowError(f"{name} has shape {tuple(given.shape)}; ({said}) is wanted")
    if not request.noise.shape[1]:
        raise WindowError("noise has no token; a window has a horizon of one at least")


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    """Whether a shape has the wanted lengths, where None matches any."""
    return len(shape) == len(wanted) and all(w in (None, s) for s, w in zip(shape, wanted, strict=True))


def lay_out(model: Model, request: WindowRequest, history: Tensor, translation: Tensor, heading: Tensor) -> WindowState:
    """The state before the first step, from history tokens (B, N_h, 5P + L) that are already recentred.

    translation: (B, 3), metres, from the window's frame to the world's; heading: (B), radians, at the first frame.
    The request has been checked. Raises WindowError if history and horizon do not fit into its frames.
    """
    patch, (batch, history_tokens) = model.config.patch, history.shape[:2]
    num_tokens = request.num_frames // patch
    if history_tokens + request.noise.shape[1] > num_tokens:
        needed = (history_tokens + request.noise.shape[1]) * patch
        raise WindowError(f"the window has {request.num_frames} frames; history and horizon alone need {needed}")
    history_len = torch.full((batch,), history_tokens * patch, device=history.device)
    tokens = history.new_zeros(batch, num_tokens, history.shape[-1])
    tokens[:, :history_tokens] = history
    tokens[:, history_tokens : history_tokens + request.noise.shape[1]] = request.noise
    observed, mask, projection = request.observed, request.mask, None
    first, count = history_tokens * patch, request.noise.shape[1] * patch
    before = motion_before(model.representation, history, patch)
    if observed is not None and mask is not None:
        observed, mask = local_goals(model.representation, observed, mask, translation, history_len)
        if model.sampling.project_root:
            projection = make_projection(
                model.representation,
                observed,
                mask,
                request.planned,
                first=first,
                num_frames=count,
                options=model.sampling,
                before=before,
            )
    else:
        projection = free_projection(before, first, count, model.sampling)
    window = Window(
        history_len=history_len,
        generation_len=torch.full_like(history_len, request.noise.shape[1] * patch),
        num_frames=request.num_frames,
        text=request.text,
        heading=heading,
        observed=observed,
        mask=mask,
        projection=projection,
        patch=patch,
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
    window, options = state.window, model.sampling.projection
    if state.root is not None and window.projection is not None and num_steps - 1 - index >= options.led_steps:
        window = replace(window, kept=KeptRoots(state.root, window.projection.leads(options.led_frames)))
    if index >= options.last_steps:
        window = replace(window, projection=None)
    clean = guided_prediction(model.denoiser, state.tokens, base_step, window, state.passes)
    moved = schedule.reverse_step(state.tokens, clean, rows, counts)
    horizon = state.window.generation_tokens[..., None]
    root = clean[..., : model.config.denoiser.root_token_width]
    return replace(state, tokens=torch.where(horizon, moved, state.tokens), root=root)


def finish_window(model: Model, state: WindowState) -> Tensor:
    """Normalised features (B, H + G, D) in the world frame; the history part is a re-synthesis."""
    lengths = state.window.history_len + state.window.generation_len
    return model.codec.from_hybrid(world_tokens(model, state), lengths)


def world_tokens(model: Model, state: WindowState) -> Tensor:
    """The finished hybrid tokens of history and horizon in the world frame, latents rounded to the grid."""
    num_known = int((state.window.history_len + state.window.generation_len).max()) // model.config.patch
    return world_tokens_of(model, state.tokens[:, :num_known], state.translation)


def world_tokens_of(model: Model, tokens: Tensor, translation: Tensor) -> Tensor:
    """Hybrid tokens (B, N, 5P + L) moved by (B, 3) metres, their latents rounded to the quantisation grid."""
    tokens = move_root(model, tokens, translation)
    width = model.config.denoiser.root_token_width
    return torch.cat([tokens[..., :width], model.codec.requantize(tokens[..., width:])], dim=-1)


@torch.no_grad()
def denoise_window(model: Model, request: WindowRequest, passes: PassBatch | None = None) -> WindowState:
    """Denoise one whole window. passes: of each step, instead of all that the guidance formula has."""
    state = start_window(model, request)
    if passes is not None:
        state = replace(state, passes=passes)
    for index in reversed(range(request.num_steps)):
        state = denoise_step(model, state, index, request.num_steps)
    return state


def commit_window(model: Model, request: WindowRequest, finished: Tensor) -> Tensor:
    """The horizon of a finished window as it is to be played, with the corrections of the model's sampling options.

    finished: (B, H + G, D), from `finish_window`. Returns normalised features (B, G, D) in the world frame.
    """
    end = finished.shape[1]
    start = end - request.noise.shape[1] * model.config.patch
    history = finished[:, :0] if request.history is None else request.history
    goals = None
    if request.observed is not None and request.mask is not None:
        goals = request.observed[:, start:end], request.mask[:, start:end]
    new, patch = finished[:, start:], model.config.patch
    return correct_window(model.representation, history, new, goals, model.sampling, patch)
