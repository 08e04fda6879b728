"""Joins: jumps of speed between the frames of one token and those of the next are taken out.

A decoder makes the frames of a token together, so motion is smoother inside a token than from one to the next. A jump
is what a step between two frames has more than its two neighbours have on average; constant acceleration has none. It
is shared out to the frames on both sides; at the start of a window, where the history cannot change, to those after.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from ardy.config import FRAMES_PER_TOKEN
from ardy.rotation import matrix_from_6d, matrix_to_6d
from ardy.sampling.options import JoinOptions
from ardy.sampling.pose import Poses
from ardy.sampling.spread import smooth_step, spread

SHARES = (0.375, 0.125)  # of a jump, that the first and the second frame on either side move against it


@lru_cache
def join_operator(num_frames: int, seam_frames: int) -> Tensor:
    """(T, T): what joined frames are of the frames they were; frame 0 is of the history, frame 1 starts a token."""
    frames = torch.arange(num_frames, dtype=torch.float64)
    joined = torch.eye(num_frames, dtype=torch.float64)
    if num_frames > 2:
        fade = 1 - smooth_step((frames - 1) / seam_frames)
        fade[0] = 0
        jump = torch.zeros(num_frames, dtype=torch.float64)
        jump[:3] = torch.tensor([-1.0, 2.0, -1.0])  # the first step less the second
        joined -= fade[:, None] * jump
    for first in range(1 + FRAMES_PER_TOKEN, num_frames - 1, FRAMES_PER_TOKEN):
        jump = torch.zeros(num_frames, dtype=torch.float64)
        jump[first - 2 : first + 2] = torch.tensor([0.5, -1.5, 1.5, -0.5])
        share = torch.zeros(num_frames, dtype=torch.float64)
        for distance, part in enumerate(SHARES):
            share[first - 1 - distance], share[first + distance] = part, -part
        share[0] = 0
        joined = (torch.eye(num_frames, dtype=torch.float64) + share[:, None] * jump) @ joined
    return joined.float()


def join_tokens(poses: Poses, options: JoinOptions, root_held: Tensor) -> None:
    """Smooth the joins of poses (B, T), frame 0 of which is of the history and does not change.

    root_held: (B, T) bool, frames at which the root is where it shall be and stays there.
    """
    operator = join_operator(poses.root.shape[1], options.seam_frames).to(poses.root)
    joined = torch.einsum("ts,bsk->btk", operator, poses.root)
    back = spread((poses.root - joined)[:, :, None], root_held[..., None], options.seam_frames)[:, :, 0]
    back[:, 0] = 0
    poses.root = joined + back
    poses.rotations = matrix_from_6d(torch.einsum("ts,bsjk->btjk", operator, matrix_to_6d(poses.rotations)))
