"""Flips: bodies that face elsewhere from one frame to the next are turned back, and led past what lies between.

Where a root turns round, the body stage may look the old way for a few tokens too long, and be round with the next:
half a turn between two frames. The frames about such a flip are of neither way, limbs in all directions. In people's
motion root and body never part like that, so a flip is known by it.
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

# Root and body part by at least so much between two frames where a body flips, and where poses about it are of no use.
FLIP_RAD, FAR_RAD = 0.2, 0.8
BRIDGED_FRAMES = 3
"""Before and after the first frame behind a far flip."""
# The sine of the slope from which on a line of hips tells of lying rather than of facing.
STEEP = 0.8


def undo_flips(before: Poses, poses: Poses, heading: Tensor) -> None:
    """Turn poses (B, G) in place so that none faces elsewhere at once than the one before it, as seen from its root.

    before: the pose (B, 1) that they follow; heading: (B, 1 + G, 2) cosine and sine, of both. To be done before poses
    are joined, which would lead limbs round with a flip. Who lies on a side faces nowhere. Rows without a flip stay bit
    for bit.
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
    """Rotations (B, G, J, 3, 3) with the frames about far flips led from the pose before them to the one after.

    before: (B, 1, J, 3, 3); heading: (B, 1 + G, 2); far: (B, G), flips into those frames. What a window ends with stays
    as it is, since nothing comes after.
    """
    every = torch.cat([before, rotations], dim=1)
    num_frames = every.shape[1]
    about = within(far[..., None], BRIDGED_FRAMES)
    sound = torch.cat([torch.ones_like(about[:, :1]), ~about], dim=1)
    left, right = gaps(sound)
    frames = torch.arange(num_frames, device=every.device)[None, :, None]
    weight = smooth_step((frames - left).to(every.dtype) / (right - left).clamp(min=1))[..., None]
    angle = angle_of(heading[..., 1], heading[..., 0])
    seen = matrix_to_6d(rotated_about_up(every, -angle))  # from the root, which turns on meanwhile
    first, last = (_at(seen, frame.clamp(max=num_frames - 1)) for frame in (left, right))
    led = rotated_about_up(matrix_from_6d(torch.lerp(first, last, weight)), angle)
    # Where both axes that tell a turn oppose each other, none lies between: such a joint keeps its own way.
    apart = (first * last).sum(dim=-1) < 0.0
    return torch.where((~sound & (right < num_frames) & ~apart)[..., None, None], led, every)[:, 1:]


def _at(values: Tensor, frames: Tensor) -> Tensor:
    """Values (B, T, J, k) at frames (B, T, 1)."""
    return values.gather(1, frames[..., None].expand(-1, -1, *values.shape[2:]))


def _rows_of(far: Tensor) -> Tensor | None:
    """The rows of (B, G) that have any; on a GPU None, for all of them, since to ask would be to wait."""
    return None if far.device.type == "cuda" else far.any(dim=1).nonzero().flatten()
