"""Joint goals: brings hands, feet, head, the root's height and whole poses onto their goals.

The correction that a goal needs at its frame grows and fades smoothly over the frames around it. Frame 0, the last of
the history, does not change, and soon after it a goal is corrected only as far as a bounded acceleration allows. At the
beginning of a motion there is no history: frame 0 is then a copy of the first frame, with the same goals.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.rotation import axis_angle_to_matrix
from motiongen_ardy.model.sampling.joint_goals import JointGoals
from motiongen_ardy.model.sampling.limbs import arms, legs
from motiongen_ardy.model.sampling.options import ReachOptions
from motiongen_ardy.model.sampling.pose import Poses
from motiongen_ardy.model.sampling.spread import PEAK_ACCELERATION, spread
from motiongen_ardy.model.sampling.turns import middle_turns, pose_turns

ROOT_SHARE = 0.25  # of the acceleration that a joint may get
LEVER_M = 0.5  # assumed distance from its axis at which a turned joint moves its children


def over_time(
    values: Tensor, known: Tensor, most_acceleration: float, fps: int, options: ReachOptions, goes_on: bool = True
) -> Tensor:
    """Corrections (B, T, C, k), known at some frames (B, T, C), extended to all frames; reduced if they come too early.

    goes_on: frame 0 belongs to the history and gets no correction.
    """
    if not goes_on:
        return spread(torch.where(known[..., None], values, 0.0), known, options.fade_frames)
    frames = torch.arange(values.shape[1], device=values.device, dtype=values.dtype)
    room = (frames.clamp(max=options.fade_frames) / fps).square() * most_acceleration / PEAK_ACCELERATION
    unlimited = frames >= options.fade_frames
    room = torch.where(unlimited, torch.inf, room)[:, None, None]
    size = values.norm(dim=-1, keepdim=True)
    values = torch.where(known[..., None], values * (room / size.clamp(min=1e-8)).clamp(max=1), 0.0)
    known = known.clone()
    known[:, 0] = True
    return spread(values, known, options.fade_frames)


def reach_joints(poses: Poses, goals: JointGoals, options: ReachOptions, goes_on: bool = True) -> Tensor:
    """Bring poses (B, T) onto their goals. Returns where (B, T, 2) the left and right foot had one.

    goes_on: frame 0 belongs to the history and does not change; otherwise it is a copy of the first, with its goals.
    """
    layout, skeleton = poses.layout, poses.layout.skeleton

    def spread_out(values: Tensor, known: Tensor, share: float) -> Tensor:
        return over_time(values, known, share * options.acceleration_m_s2, layout.fps, options, goes_on)

    if bool(goals.has_height.any()):
        off = torch.where(goals.has_height, goals.height - poses.root[..., 1], 0.0)[..., None, None]
        _raise_root(poses, spread_out(off, goals.has_height[..., None], ROOT_SHARE)[:, :, 0])
    turns, known = pose_turns(skeleton, goals, poses.rotations, poses.positions())
    poses.turn(range(skeleton.num_joints), axis_angle_to_matrix(spread_out(turns, known, 1 / LEVER_M)))
    limbs = (*legs(skeleton), *arms(skeleton))
    turns, known = middle_turns(skeleton, goals, poses.positions())
    if bool(known.any()):
        turned = axis_angle_to_matrix(spread_out(turns, known, 1 / LEVER_M))
        poses.turn([limb.upper for limb in limbs], turned)
    ends, tips = [limb.end for limb in limbs], [limb.tip for limb in limbs]
    at_end, at_tip = goals.has_position[:, :, ends], goals.has_position[:, :, tips]
    if bool((at_end | at_tip).any()):
        positions = poses.positions()
        to_end, to_tip = ((goals.positions - positions)[:, :, joints] for joints in (ends, tips))
        offset = torch.where(at_end[..., None], to_end, to_tip)
        moved = spread_out(offset, at_end | at_tip, 1.0)
        poses.bend_limbs(limbs, positions, positions[:, :, ends] + moved, (moved != 0).any(dim=-1))
    return (at_end | at_tip | goals.has_rotation[:, :, ends])[:, :, :2]


def _raise_root(poses: Poses, rise: Tensor) -> None:
    """Raise the root by (B, T, 1) metres while the feet stay in place."""
    positions = poses.positions()
    rise = rise * rise.new_tensor([0.0, 1.0, 0.0])
    poses.root += rise
    limbs = legs(poses.layout.skeleton)
    ankles = positions[:, :, [limb.end for limb in limbs]]
    poses.bend_limbs(limbs, positions + rise[:, :, None], ankles, (rise != 0).any(dim=-1, keepdim=True))
