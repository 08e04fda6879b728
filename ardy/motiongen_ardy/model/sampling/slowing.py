"""Slowing: a walking character comes to a stand gradually, not from one frame to the next.

With a prompt to stand, the network may stop the root at once. The speed of the history is then continued and faded out;
the body stage sees the slowing root and takes a last step.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.tokenizer.model import root_from_tokens

_STATE_FRAMES = 6  # frames over which the history's speed is measured: fewer show the sway of a step
_LOST_S = 0.2  # time within which a loss of speed is measured
FREE_M_S = 0.3  # a loss up to this is the sway of a step


def motion_before(layout: Representation, history: Tensor, patch: int) -> Tensor:
    """The root at the end of history tokens (B, N, 5P + L): (B, 4), x and z in metres in their own frame, and its
    velocity in metres a second. All zero without history; the velocity is zero if it is no more than the sway of a
    step.
    """
    num_tokens = -(-_STATE_FRAMES // patch)
    root = root_from_tokens(history[:, -num_tokens:], patch)[:, -_STATE_FRAMES:, :ROOT_WIDTH]
    if not root.shape[1]:
        return history.new_zeros(len(history), 4)
    ground = layout.root_stats.denormalize(root)[..., 0:3:2]
    velocity = (ground[:, -1] - ground[:, 0]) * (layout.fps / max(1, ground.shape[1] - 1))
    velocity = torch.where(velocity.norm(dim=-1, keepdim=True) > FREE_M_S, velocity, 0.0)
    return torch.cat([ground[:, -1], velocity], dim=-1)


def slowed(ground: Tensor, before: Tensor, seconds: float, fps: int) -> Tensor:
    """The correction (B, T, 2), in metres, that makes a root's path (B, T, 2) continue from `before` (B, 4).

    before: from `motion_before`; with zero velocity there is no correction. The speed that the path loses in its first
    frames, beyond the sway of a step, is restored and fades over `seconds`.
    """
    num_frames = ground.shape[1]
    place, velocity = before[:, None, :2], before[:, 2:]
    speed = velocity.norm(dim=-1, keepdim=True)  # (B, 1)
    along = velocity / speed.clamp(min=1e-6)
    count = min(max(1, round(_LOST_S * fps)), num_frames)
    made = ((ground[:, count - 1 : count] - place)[:, 0] * along).sum(dim=-1, keepdim=True) * (fps / count)
    lost = torch.minimum((speed - made - FREE_M_S).clamp(min=0), speed)
    share = torch.arange(1, num_frames + 1, device=ground.device, dtype=ground.dtype) / (seconds * fps)
    way = seconds / 3 * (1 - (1 - share.clamp(max=1)) ** 3)  # integral of a speed that fades as (1 - share)^2
    return (lost * along)[:, None] * way[:, None]
