"""The reference rollout: one character, window after window, without optimisations. The serving engine must equal it.

Each window starts from the last frames before it, encoded anew from explicit features or, on request, from their
tokens if those are kept and fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import count, pairwise

import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.config import ModelConfig
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.generation import WindowRequest, commit_window, denoise_window, finish_window, world_tokens
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.noise import window_noise
from motiongen_ardy.model.sampling.plan import plan_window
from motiongen_ardy.model.sampling.window_end import frames_to_keep
from motiongen_ardy.model.token_history import TokenHistory
from motiongen_ardy.model.window import WindowError

DEFAULT_HISTORY_FRAMES = 16


def usual_history(patch: int) -> int:
    """The default history of a window: whole tokens of `patch` frames, at least one."""
    return max(1, DEFAULT_HISTORY_FRAMES // patch) * patch


def visible_frames(model: Model, history_frames: int, targets: Targets | None, first_frame: int) -> int:
    """The length of a window that sees its constraints: history and horizon, or up to the furthest constraint within
    the longest window, in whole tokens. first_frame: the frame at which the window's history starts.
    """
    shortest = history_frames + model.config.horizon
    if targets is None:
        return shortest
    longest = model.config.max_window_frames
    ahead = [frame - first_frame + 1 for frame in targets.frames if history_frames <= frame - first_frame < longest]
    patch = model.config.patch
    needed = -(-max(ahead, default=0) // patch) * patch
    return max(shortest, min(needed, longest))


@dataclass(frozen=True)
class RolloutRequest:
    """One character's motion, num_frames long.

    text: finite, (W) or (n, W), zeros for no text.
    later_text: (first frame, text) of the prompts that follow, in order of time; a window that would extend beyond a
    prompt's first frame is kept only up to it.
    seed: the k-th window starts from `window_noise(seed, k)`.
    history_frames: the most frames of history of a window, a multiple of the patch; None: `usual_history`.
    reuse_tokens: a history that is covered by whole tokens of earlier windows is not encoded again; has no effect if
    windows are corrected, since tokens do not include corrections.
    targets: constraints by absolute frame. start: x and z in metres, heading in radians.
    keep_prompts: use the prompts even where the model's sampling would use a gait's, because targets contradict them.
    """

    num_frames: int
    text: Tensor
    seed: int = 0
    num_steps: int = 10
    weights: GuidanceWeights | None = None
    history_frames: int | None = None
    reuse_tokens: bool = False
    targets: Targets | None = None
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    later_text: tuple[tuple[int, Tensor], ...] = ()
    keep_prompts: bool = False

    def check(self, config: ModelConfig) -> None:
        """Raise WindowError for what no model of this configuration can do, and for numbers that are not finite."""
        patch = config.patch
        if self.num_frames < 0:
            raise WindowError(f"num_frames is {self.num_frames}; give 0 or more")
        if not all(map(math.isfinite, self.start)):
            raise WindowError(f"start is {self.start}; x, z and heading must be finite numbers")
        for text in (self.text, *(text for _, text in self.later_text)):
            _check_text(text, config.denoiser.text_dim)
        if self.history_frames is not None and (self.history_frames < patch or self.history_frames % patch):
            raise WindowError(f"history_frames is {self.history_frames}; give a positive multiple of {patch}")
        changes = [patch - 1, *(frame for frame, _ in self.later_text)]
        if any(later <= earlier for earlier, later in pairwise(changes)):
            raise WindowError(f"later_text starts at frames {changes[1:]}; they must rise, the first from {patch} on")

    def history_at(self, frame: int, patch: int) -> int:
        """The number of history frames of a window that starts at `frame`."""
        longest = usual_history(patch) if self.history_frames is None else self.history_frames
        return min(longest, frame // patch * patch)

    def prompt_at(self, frame: int) -> tuple[Tensor, int]:
        """The text (n, W) in force at a frame, and the first frame of the next one (num_frames if there is none)."""
        text, end = self.text, self.num_frames
        for first, later in self.later_text:
            if first > frame:
                return torch.atleast_2d(text), min(first, end)
            text = later
        return torch.atleast_2d(text), end


def _check_text(text: Tensor, width: int) -> None:
    if text.dim() not in (1, 2) or text.shape[-1] != width:
        raise WindowError(f"a text has shape {tuple(text.shape)}; this model takes ({width},) or (n, {width})")
    if not bool(text.isfinite().all()):
        raise WindowError("a text holds NaN or infinite numbers; every one must be finite")


def next_window(model: Model, request: RolloutRequest, features: Tensor, index: int) -> tuple[WindowRequest, int]:
    """Window `index` of a rollout, as a batch of one, and the frame up to which it is kept: its horizon may be cut
    short by another text, or to leave a goal more room. features: (T, D), normalised, all frames before it.
    """
    layout, done = model.representation, len(features)
    device, x, z, heading = features.device, *request.start
    history_len = request.history_at(done, model.config.patch)
    first_frame = done - history_len
    text, end = request.prompt_at(done)
    text = text.to(features.dtype)
    end = min(end, done + frames_to_keep(request.targets, done, model.config.horizon, model.sampling))
    history, keep = features[first_frame:], request.keep_prompts
    targets, told = plan_window(model, request.targets, text, history, done, request.start, keep_text=keep)
    end = end if told.led_to is None else min(end, told.led_to)
    span = visible_frames(model, history_len, targets, first_frame)
    observed, mask, planned = None, None, None
    if targets is not None:
        observed, mask = (part[None] for part in targets.observe(layout, first_frame, span))
        planned = targets.planned_frames(first_frame, span)[None].to(device)
    noise = window_noise(request.seed, index, model.config.horizon_tokens, model.config.token_width)
    window = WindowRequest(
        num_frames=span,
        num_steps=request.num_steps,
        text=told.text[None].to(device),
        noise=noise[None].to(device),
        weights=request.weights,
        history=history[None] if history_len else None,
        translation=torch.tensor([[x, 0.0, z]], dtype=features.dtype, device=device),
        heading=torch.tensor([heading], dtype=features.dtype, device=device),
        observed=observed,
        mask=mask,
        planned=planned,
    )
    return window, end


@torch.no_grad()
def rollout(model: Model, request: RolloutRequest) -> Tensor:
    """Normalised features (num_frames, D) in the world frame, generated window after window.

    Bit for bit reproducible for the same request on one machine; with another number of threads
    (`torch.set_num_threads`), products are summed in another order, and the last digits differ. Raises WindowError for
    a request that does not fit the model's tokens or texts, and ConstraintError for targets of another skeleton.
    """
    request.check(model.config)
    # Ignore the caller's autocast: the model itself decides in which precision it multiplies.
    with torch.autocast(model.representation.stats.mean.device.type, enabled=False):
        return _rollout(model, request)


def _rollout(model: Model, request: RolloutRequest) -> Tensor:
    layout = model.representation
    features = layout.stats.mean.new_zeros(0, layout.feature_dim)
    kept = TokenHistory(model.config.patch)
    for index in count():
        done = len(features)
        if done >= request.num_frames:
            return features
        window, end = next_window(model, request, features, index)
        known = kept.before(done, window.history_frames) if request.reuse_tokens else None
        if known is not None:
            window = replace(window, history_tokens=known[None])
        state = denoise_window(model, window)
        new = commit_window(model, window, finish_window(model, state))[0]
        if not model.sampling.corrects:  # tokens do not include corrections
            kept.replace_from(done, world_tokens(model, state)[0, window.history_frames // model.config.patch :])
        features = torch.cat([features, new[: end - done]])
