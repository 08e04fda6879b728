"""Flips: bodies that suddenly face elsewhere from one frame to the next are turned back.

When a root turns round, the body stage may face the old way for a few tokens too long and the new way from the next
token on: half a turn between two frames. In the frames around such a flip, poses are a mixture of both, with limbs in
all directions; they are replaced by interpolated ones. In captured motion, root and body never diverge like that, which
is how a flip is detected.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.rotation import angle_of, matrix_from_6d, matrix_to_6d
from motiongen_ardy.core.skeleton import hip_lines
from motiongen_ardy.model.sampling.facing import off_heading
from motiongen_ardy.model.sampling.pose import Poses, rotated_about_up
from motiongen_ardy.model.sampling.spread import gaps, smooth_step, within
from motiongen_ardy.model.sampling.twist import wrapped_steps

# Change of the angle between root and body, between two frames, that counts as a flip, and as one with useless poses.
FLIP_RAD, FAR_RAD = 0.2, 0.8
BRIDGED_FRAMES = 3
"""Frames that are interpolated, before and after the first frame behind a far flip."""
# The sine of the slope above which the line of the hips shows lying rather than facing.
STEEP = 0.8


def undo_flips(before: Poses, poses: Poses, heading: Tensor) -> None:
    """Turn poses (B, G) in place so that none suddenly faces elsewhere than the one before it, relative to its root.

    before: the pose (B, 1) that precedes them; heading: (B, 1 + G, 2) cosine and sine, of both. Must be called before
    poses are joined, which would swing limbs round with a flip. A body that lies on its side has no facing. Rows
    without a flip stay bit for bit the same.
    """
    skeleton = poses.layout.skeleton
    lines = torch.cat([hip_lines(skeleton, part.rotations) for part in (before, poses)], dim=1)
    level = lines[..., 1].abs() < STEEP * lines.norm(dim=-1)
    steps = wrapped_steps(off_heading(lines, heading)) * (level[:, 1:] & level[:, :-1])
    poses.turn_about_up((steps * (steps.abs() > FLIP_RAD)).cumsum(dim=1))
    far = steps.abs() > FAR_RAD
    rows = _rows_of(far)
    if rows is None:
        poses.rotations = _bridged(before.rotations, poses.rotations, heading, far)
    elif len(rows):
        poses.rotations[rows] = _bridged(before.rotations[rows], poses.rotations[rows], heading[rows], far[rows])


def _bridged(before: Tensor, rotations: Tensor, heading: Tensor, far: Tensor) -> Tensor:
    """Rotations (B, G, J, 3, 3), interpolated around far flips from the pose before them to the pose after.

    before: (B, 1, J, 3, 3); heading: (B, 1 + G, 2); far: (B, G), flips into those frames. Frames that reach to the end
    of the window are left as they are, since no pose follows to interpolate to.
    """
    every = torch.cat([before, rotations], dim=1)
    num_frames = every.shape[1]
    about = within(far[..., None], BRIDGED_FRAMES)
    sound = torch.cat([torch.ones_like(about[:, :1]), ~about], dim=1)
    left, right = gaps(sound)
    frames = torch.arange(num_frames, device=every.device)[None, :, None]
    weight = smooth_step((frames - left).to(every.dtype) / (right - left).clamp(min=1))[..., None]
    angle = angle_of(heading[..., 1], heading[..., 0])
    seen = matrix_to_6d(rotated_about_up(every, -angle))  # relative to the root, which goes on turning
    first, last = (_at(seen, frame.clamp(max=num_frames - 1)) for frame in (left, right))
    led = rotated_about_up(matrix_from_6d(torch.lerp(first, last, weight)), angle)
    # If the two 6-D rotations are opposed, interpolation is meaningless: such a joint keeps its own rotations.
    apart = (first * last).sum(dim=-1) < 0.0
    return torch.where((~sound & (right < num_frames) & ~apart)[..., None, None], led, every)[:, 1:]


def _at(values: Tensor, frames: Tensor) -> Tensor:
    """Values (B, T, J, k) at frames (B, T, 1)."""
    return values.gather(1, frames[..., None].expand(-1, -1, *values.shape[2:]))


def _rows_of(far: Tensor) -> Tensor | None:
    """The rows of (B, G) that have any; on a GPU None, meaning all rows, since finding out would synchronise."""
    return None if far.device.type == "cuda" else far.any(dim=1).nonzero().flatten()
