"""Joins: removes jumps of speed between the frames of one token and those of the next.

A decoder makes the frames of a token together, so motion is smoother within a token than from one to the next. The jump
at a step between two frames is its excess over the mean of its two neighbouring steps; constant acceleration has none.
It is distributed over the frames on both sides or, at the start of a window, whose history cannot change, over those
after it.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from motiongen_ardy.core.constants import MOST_TABLES
from motiongen_ardy.core.rotation import matrix_from_6d, matrix_to_6d
from motiongen_ardy.model.sampling.options import JoinOptions
from motiongen_ardy.model.sampling.spread import smooth_step, spread

HISTORY_FRAMES = 2
SHARES = (0.375, 0.125)  # of a jump, by which the first and second frame on either side are moved against it
JUMP = (0.5, -1.5, 1.5, -0.5)  # weights of two frames before a join and two after it
JUMP_FROM_ONE = (-1.0, 2.0, -1.0)  # the same if only one frame before it is known


@lru_cache
def join_operator(num_before: int, num_new: int, seam_frames: int, patch: int) -> Tensor:
    """(num_new, num_before + num_new): the linear map from the original frames to the joined new ones.

    num_before: 0 to 2 frames of history, which do not change; the first new frame starts a token of `patch` frames.
    """
    total = num_before + num_new
    joined = torch.eye(total, dtype=torch.float64)

    def share_out(share: Tensor, first: int, jump: tuple[float, ...], joined: Tensor) -> Tensor:
        read = torch.zeros(total, dtype=torch.float64)
        read[first : first + len(jump)] = torch.tensor(jump, dtype=torch.float64)
        return joined + share[:, None] * (read @ joined)

    if num_before and num_new > 1:
        fade = smooth_step((torch.arange(total, dtype=torch.float64) - num_before) / seam_frames) - 1
        fade[:num_before] = 0
        joined = share_out(fade, 0, JUMP if num_before == HISTORY_FRAMES else JUMP_FROM_ONE, joined)
    for first in range(num_before + patch, total - 1, patch) if patch > 1 else ():
        share = torch.zeros(total, dtype=torch.float64)
        for distance, part in enumerate(SHARES):
            share[first - 1 - distance], share[first + distance] = part, -part
        joined = share_out(share, first - 2, JUMP, joined)
    return joined[num_before:].float()


@lru_cache(maxsize=MOST_TABLES)
def _operator_on(
    num_before: int, num_new: int, seam_frames: int, patch: int, dtype: torch.dtype, device: torch.device
) -> Tensor:
    """The operator on a device, copied there once, as in `core.constants`."""
    with torch.inference_mode(False):
        return join_operator(num_before, num_new, seam_frames, patch).to(device, dtype)


def join_roots(history: Tensor, new: Tensor, options: JoinOptions, held: Tensor, patch: int) -> Tensor:
    """The joined root positions (B, G, 3) of the new frames, in metres.

    history: (B, H, 3), of which only the last two frames are used. held: (B, G) bool, frames at which the root is on a
    goal and stays there. patch: frames per token.
    """
    moved = _joined(history, new, options, patch)
    back = (new - moved)[:, :, None]
    return moved + spread(back, held[..., None], options.seam_frames)[:, :, 0]


def join_rotations(history: Tensor, new: Tensor, options: JoinOptions, patch: int) -> Tensor:
    """The joined rotations (B, G, J, 3, 3) of the new frames. history: (B, H, J, 3, 3); patch as in `join_roots`."""
    before, after = (matrix_to_6d(rotations).flatten(-2) for rotations in (history, new))
    return matrix_from_6d(_joined(before, after, options, patch).unflatten(-1, (-1, 6)))


def _joined(history: Tensor, new: Tensor, options: JoinOptions, patch: int) -> Tensor:
    """The new frames' numbers (B, G, k), joined."""
    before = history[:, -HISTORY_FRAMES:]
    operator = _operator_on(before.shape[1], new.shape[1], options.seam_frames, patch, new.dtype, new.device)
    # One product per row: a single product of all rows would sum in an order that depends on the batch.
    return torch.bmm(operator.expand(len(new), -1, -1), torch.cat([before, new], dim=1))
