"""Slowing: who walks comes to a stand over some steps of the root, and not from one frame to the next.

Told to stand, the network may put the root to rest at once. Its speed then goes on from the history's and fades; the
body stage sees the root that slows, and takes its last step on it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.tokenizer.model import root_from_tokens

_STATE_FRAMES = 6  # that the history's speed is taken over: fewer show the sway of a step
_LOST_S = 0.2  # within which a speed is lost or kept
FREE_M_S = 0.3  # that a step's sway may lose


def motion_before(layout: Representation, history: Tensor, patch: int) -> Tensor:
    """Where the root is at the end of history tokens (B, N, 5P + L), x and z in metres of their own frame, and how fast
    it goes, metres a second: (B, 4); zeros without history, and for a speed that a step sways by.
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
    """What is to be added (B, T, 2) metres to a root's way (B, T, 2) so that it goes on from `before` (B, 4).

    before: as `motion_before`; a speed of zero asks for nothing. What the way loses of that speed in its first frames,
    beyond what a step sways by, is given back and fades over `seconds`.
    """
    num_frames = ground.shape[1]
    place, velocity = before[:, None, :2], before[:, 2:]
    speed = velocity.norm(dim=-1, keepdim=True)  # (B, 1)
    along = velocity / speed.clamp(min=1e-6)
    count = min(max(1, round(_LOST_S * fps)), num_frames)
    made = ((ground[:, count - 1 : count] - place)[:, 0] * along).sum(dim=-1, keepdim=True) * (fps / count)
    lost = torch.minimum((speed - made - FREE_M_S).clamp(min=0), speed)
    share = torch.arange(1, num_frames + 1, device=ground.device, dtype=ground.dtype) / (seconds * fps)
    way = seconds / 3 * (1 - (1 - share.clamp(max=1)) ** 3)  # of a speed that fades as the square of what is left
    return (lost * along)[:, None] * way[:, None]
