"""A whole clip from kept tokens, as the golden clips were computed: the same windows, joined in another way.

`rollout` encodes each history again; here the tokens of all windows are kept, and decoded at the end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.generation import (
    WindowRequest,
    WindowState,
    denoise_step,
    lay_out,
    move_root,
    recentre_tokens,
)
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.tokenizer.model import root_from_tokens

PATCH = 4


@dataclass(frozen=True)
class WholeClip:
    """A clip of num_frames frames in windows of the model's horizon.

    noise: (windows, B, G/4, 20 + L); text: (B, n, W); heading: (B) radians at the start. observed, mask: (B,
    num_frames, D), normalised, world frame, or None. crop_frames: how much history a window sees, None for all of it.
    """

    num_frames: int
    num_steps: int
    text: Tensor
    noise: Tensor
    heading: Tensor
    weights: GuidanceWeights
    observed: Tensor | None
    mask: Tensor | None
    crop_frames: int | None


@dataclass(frozen=True)
class ClipState:
    """A clip between two windows.

    tokens: (B, N, 20 + L), all so far, recentred at their last frame, latents on the grid; translation: (B, 3) metres
    from their coordinates to the world's; heading: (B) radians of the first frame that the next window sees.
    """

    tokens: Tensor
    translation: Tensor
    heading: Tensor

    @property
    def num_frames(self) -> int:
        return self.tokens.shape[1] * PATCH


def start_clip(model: Model, clip: WholeClip) -> ClipState:
    batch, width = len(clip.text), model.config.token_width
    return ClipState(torch.zeros(batch, 0, width), torch.zeros(batch, 3), clip.heading)


def clip_window(model: Model, clip: WholeClip, state: ClipState, index: int) -> WindowState:
    """The finished window `index` in the frame of `state`. It sees every constraint that is still ahead."""
    total = len(clip.noise) * model.config.horizon
    start = 0 if clip.crop_frames is None else max(0, state.num_frames - clip.crop_frames)
    goals = {
        name: functional.pad(part, (0, 0, 0, total - part.shape[1]))[:, start:]
        for name, part in (("observed", clip.observed), ("mask", clip.mask))
        if part is not None
    }
    request = WindowRequest(total - start, clip.num_steps, clip.text, clip.noise[index], clip.weights, **goals)
    history = state.tokens[:, start // PATCH :]
    window = lay_out(model, request, history, state.translation, state.heading)
    for step in reversed(range(clip.num_steps)):
        window = denoise_step(model, window, step, clip.num_steps)
    return window


def append_window(model: Model, clip: WholeClip, state: ClipState, window: WindowState) -> ClipState:
    """The clip with a window's horizon appended."""
    first = int(window.window.history_len[0]) // PATCH
    new = window.tokens[:, first : first + model.config.horizon_tokens]
    tokens, centre = recentre_tokens(model, torch.cat([state.tokens, new], dim=1))
    root, latents = tokens[..., : 5 * PATCH], tokens[..., 5 * PATCH :]
    tokens = torch.cat([root, model.codec.requantize(latents)], dim=-1)
    state = replace(state, tokens=tokens, translation=state.translation + centre)
    if clip.crop_frames is None:
        return state
    seen = max(0, state.num_frames - clip.crop_frames)
    return replace(state, heading=model.representation.heading_of_root(root_from_tokens(root, PATCH)[:, seen]))


def decode_clip(model: Model, clip: WholeClip, state: ClipState) -> Tensor:
    """Normalised features of all tokens, decoded at once without a crop, window by window with one."""
    tokens = move_root(model, state.tokens, state.translation)
    wanted = -(-clip.num_frames // PATCH) * PATCH

    def decode(first: int, end: int) -> Tensor:
        """Features of tokens first..end-1, decoded on their own."""
        valid = torch.arange(first * PATCH, end * PATCH) < wanted
        valid = valid.expand(len(tokens), -1)
        return model.codec.from_hybrid(tokens[:, first:end], valid.sum(1), valid)

    if clip.crop_frames is None:
        return decode(0, tokens.shape[1])
    horizon = model.config.horizon
    size, crop = horizon // PATCH, clip.crop_frames // PATCH
    parts = [decode(max(0, first - crop), first + size)[:, -horizon:] for first in range(0, tokens.shape[1], size)]
    return torch.cat(parts, dim=1)
