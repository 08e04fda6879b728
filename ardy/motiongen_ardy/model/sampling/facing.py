"""Facing: the body turned to where its root looks.

A root says its heading, a body shows one in the line of its hips, and in people's motion the two are the same. A body
stage that did not follow its root leaves them apart: then the whole body is turned about its root, as smoothly as they
part. (Where they part at once, `flips` has been at work before.)
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from motiongen_ardy.core.representation import facing_of
from motiongen_ardy.core.rotation import angle_of
from motiongen_ardy.core.skeleton import hip_lines
from motiongen_ardy.model.sampling.pose import Poses
from motiongen_ardy.model.sampling.twist import wrapped_steps

# Less than this is the error of a decoder and the sway of hips, and stays.
SWAY_RAD = 0.05
_WEIGHTS = (1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0)


def face_root(poses: Poses, heading: Tensor) -> None:
    """Turn poses (B, T), frame 0 of which is of the history and does not change. heading: (B, T, 2) cosine and sine."""
    off = off_heading(hip_lines(poses.layout.skeleton, poses.rotations), heading)
    # A body that is turned right round goes on turning the way it began.
    off = torch.cat([off[:, :1], off[:, :1] + wrapped_steps(off).cumsum(dim=1)], dim=1)
    off = off.sign() * (off.abs() - SWAY_RAD).clamp(min=0)
    reach = len(_WEIGHTS) // 2
    padded = functional.pad(off[:, None], (reach, reach), mode="replicate")[:, 0]
    # A convolution would have a kernel of oneDNN for each shape of a batch, and round otherwise in another batch.
    turn = torch.zeros_like(off)
    for first, weight in enumerate(_WEIGHTS):
        turn = turn + weight / sum(_WEIGHTS) * padded[:, first : first + off.shape[1]]
    # Where the history ends nothing is turned: the turn sets in over the next frames.
    rise = (torch.arange(turn.shape[1], dtype=turn.dtype, device=turn.device) / (2.0 * reach)).clamp(max=1)
    turn = turn * rise * rise * (3 - 2 * rise)
    poses.turn_about_up(turn)


def off_heading(lines: Tensor, heading: Tensor) -> Tensor:
    """How far (B, T) radians, -pi to pi, bodies would have to turn to face where their roots look.

    lines: (B, T, 3) of their hips, as `hip_lines` has them; heading: (B, T, 2) cosine and sine.
    """
    off = angle_of(heading[..., 1], heading[..., 0]) - facing_of(lines)
    return angle_of(off.sin(), off.cos())
