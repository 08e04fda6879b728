"""Facing: turns the body to the heading of its root.

The root states a heading, and the hips of the body show one; in captured motion the two are the same. If the body stage
did not follow its root they differ, and the whole body is turned about its root, as smoothly as the difference grows.
(Sudden differences have been removed by `flips` before.)
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

# Smaller differences are decoding error and the sway of the hips, and are left.
SWAY_RAD = 0.05
_WEIGHTS = (1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0)


def face_root(poses: Poses, heading: Tensor) -> None:
    """Turn poses (B, T); frame 0 belongs to the history and does not change. heading: (B, T, 2) cosine and sine."""
    off = off_heading(hip_lines(poses.layout.skeleton, poses.rotations), heading)
    # A body that has to turn by 180 degrees keeps turning the way it began.
    off = torch.cat([off[:, :1], off[:, :1] + wrapped_steps(off).cumsum(dim=1)], dim=1)
    off = off.sign() * (off.abs() - SWAY_RAD).clamp(min=0)
    reach = len(_WEIGHTS) // 2
    padded = functional.pad(off[:, None], (reach, reach), mode="replicate")[:, 0]
    # A convolution would compile a oneDNN kernel for each batch shape, and round differently in different batches.
    turn = torch.zeros_like(off)
    for first, weight in enumerate(_WEIGHTS):
        turn = turn + weight / sum(_WEIGHTS) * padded[:, first : first + off.shape[1]]
    # At the end of the history nothing is turned; the turn sets in over the following frames.
    rise = (torch.arange(turn.shape[1], dtype=turn.dtype, device=turn.device) / (2.0 * reach)).clamp(max=1)
    turn = turn * rise * rise * (3 - 2 * rise)
    poses.turn_about_up(turn)


def off_heading(lines: Tensor, heading: Tensor) -> Tensor:
    """By what angle (B, T), in -pi..pi radians, bodies would have to turn to face along their roots' headings.

    lines: (B, T, 3), of their hips, as from `hip_lines`; heading: (B, T, 2) cosine and sine.
    """
    off = angle_of(heading[..., 1], heading[..., 0]) - facing_of(lines)
    return angle_of(off.sin(), off.cos())
