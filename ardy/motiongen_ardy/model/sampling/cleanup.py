"""Foot clean-up: feet that carry weight stay in place, on the ground and not in it.

A window's frames are corrected from themselves and the one frame before them, whose feet are already in place. That is
how stances continue across a seam; no other state is kept.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from motiongen_ardy.core.constants import constant, index
from motiongen_ardy.core.rotation import rotation_y
from motiongen_ardy.core.two_bone import swing
from motiongen_ardy.model.sampling.limb_ik import SOFT_REACH
from motiongen_ardy.model.sampling.limbs import Limb, legs, limb_joints
from motiongen_ardy.model.sampling.options import FeetOptions
from motiongen_ardy.model.sampling.pose import Poses
from motiongen_ardy.model.sampling.spread import smooth_step, spread
from motiongen_ardy.model.sampling.stance import contact_states, pace_of, slip
from motiongen_ardy.model.sampling.steps import ground_offsets
from motiongen_ardy.model.sampling.twist import turn_legs, turned_about_up, twist

LANDING_FRAMES = 5
SINK_M = 0.004  # how far a foot joint may be below its height on the ground
LOWER_FRAMES = 3


def clean_feet(poses: Poses, options: FeetOptions, pinned: Tensor, height_held: Tensor) -> None:
    """Hold the feet of poses (B, T) in place while they stand. Frame 0 belongs to the history and does not change.

    pinned: (B, T, 2) bool, frames at which the left or right foot is on a goal and stays there; height_held: (B, T)
    bool, frames at which the root's height is on a goal.
    """
    limbs = legs(poses.layout.skeleton)
    positions = poses.positions()
    feet = positions[:, :, index(tuple(poses.layout.skeleton.contact_joints), positions.device)]
    heel, toe = feet[:, :, 0::2], feet[:, :, 1::2]
    sole = toe - heel
    pace = pace_of(poses.root, poses.layout.fps)
    states = contact_states(poses.contacts, feet, pace, poses.layout.fps, options)
    standing = states.unflatten(2, (2, 2)).any(dim=-1)
    twisted = twist(standing, sole)
    # Where the feet would be without turning: leaves only how far they slip.
    straight = torch.stack([heel, heel + turned_about_up(sole, -twisted)], dim=3).flatten(2, 3)
    offsets, turn, lift, standing = ground_offsets(
        standing, slip(states, straight), twisted, pace, pinned, fps=poses.layout.fps, options=options
    )
    states = states.unflatten(2, (2, 2)) & standing[..., None]
    rise = _heights(feet, states.flatten(2), pinned, options).unflatten(2, (2, 2)) + lift[..., None]

    up = constant((0.0, 1.0, 0.0), feet.dtype, feet.device)
    length = sole.norm(dim=-1, keepdim=True)
    aimed = turned_about_up(sole, turn) + (rise[..., 1] - rise[..., 0])[..., None] * up
    aimed = length * aimed / aimed.norm(dim=-1, keepdim=True).clamp(min=1e-8)
    ankle = heel + offsets + rise[..., :1] * up

    lowered = _lowering(limbs, positions, ankle, states[..., 0], options)
    held = height_held[..., None]
    lowered = lowered * (1 - spread(held[..., None].to(lowered.dtype), held, options.fade_frames)[..., 0, 0])
    poses.root -= lowered[..., None] * up
    positions = positions - lowered[..., None, None] * up
    raised = _heel_rise(limbs, positions, ankle, ankle + aimed, states[..., 1])
    turned = rotation_y(turn)
    turned = swing(turned_about_up(sole, turn) / length, (ankle + aimed - raised) / length) @ turned
    poses.bend_limbs(limbs, turn_legs(poses, limbs, positions, turn), raised)
    feet_of = [(limb.end, *limb.beyond) for limb in limbs]
    sides = [side for side, joints in enumerate(feet_of) for _ in joints]
    poses.turn([joint for joints in feet_of for joint in joints], turned[:, :, index(tuple(sides), turned.device)])


def _heights(feet: Tensor, states: Tensor, pinned: Tensor, options: FeetOptions) -> Tensor:
    """How far (B, T, 4) heels and toes are to be raised: onto the ground if they stand, above it anyway."""
    ground = constant((options.heel_m, options.toe_m) * 2, feet.dtype, feet.device)
    short = ground - feet[..., 1]
    pins = pinned.repeat_interleave(2, dim=2)
    rise = spread(torch.where(states & ~pins, short, 0.0)[..., None], states | pins, LANDING_FRAMES)[..., 0]
    rise = torch.maximum(rise, torch.where(pins, rise, short - SINK_M))
    frames = torch.arange(feet.shape[1], dtype=feet.dtype, device=feet.device)[None, :, None]
    return rise - smooth_step(1 - frames / options.fade_frames) * rise[:, :1]


def _lowering(
    limbs: tuple[Limb, Limb], positions: Tensor, ankle: Tensor, heels: Tensor, options: FeetOptions
) -> Tensor:
    """How far (B, T) in metres to lower the pelvis so that the legs reach ankles (B, T, 2, 3) whose heels stand."""
    upper, _, end = limb_joints(limbs, positions.device)
    hips = positions[:, :, upper]
    before = (positions[:, :, end] - hips).norm(dim=-1)
    longest = torch.maximum(before, _reaches(limbs, before))
    line = hips - ankle
    over_ground = line[..., 0::2].square().sum(dim=-1)
    room = (longest.square() - over_ground).clamp(min=0).sqrt()
    needed = torch.where(heels, line[..., 1] - room, 0.0).amax(dim=-1).clamp(0, options.lower_m)
    width = 2 * LOWER_FRAMES + 1
    padded = functional.pad(needed[:, None], (2 * LOWER_FRAMES, 2 * LOWER_FRAMES))
    smooth = functional.avg_pool1d(functional.max_pool1d(padded, width, stride=1), width, stride=1)[:, 0]
    frames = torch.arange(needed.shape[1], dtype=needed.dtype, device=needed.device)
    return smooth * smooth_step(frames / (2 * LOWER_FRAMES))


def _reaches(limbs: tuple[Limb, Limb], like: Tensor) -> Tensor:
    """How far (2) in metres each leg reaches without being straightened."""
    return constant(tuple(SOFT_REACH * limb.length_m for limb in limbs), like.dtype, like.device)


def _heel_rise(limbs: tuple[Limb, Limb], positions: Tensor, ankle: Tensor, toe: Tensor, toes: Tensor) -> Tensor:
    """Ankles (B, T, 2, 3) that a too short leg can reach by lifting the heel over a standing toe.

    The ankle moves along the circle about the toe, in the plane of hip, ankle and toe, until the leg is long enough.
    """
    upper, _, end = limb_joints(limbs, positions.device)
    hips = positions[:, :, upper]
    before = (positions[:, :, end] - hips).norm(dim=-1)
    longest = torch.maximum(before, _reaches(limbs, before))
    sole, line = ankle - toe, hips - toe
    length, distance = sole.norm(dim=-1), line.norm(dim=-1).clamp(min=1e-6)
    toward = line / distance[..., None]
    off = sole - (sole * toward).sum(-1, keepdim=True) * toward
    off = off / off.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    cosine = (distance.square() + length.square() - longest.square()) / (2 * distance * length).clamp(min=1e-6)
    cosine = cosine.clamp(-1, 1)[..., None]
    lifted = toe + length[..., None] * (cosine * toward + (1 - cosine.square()).sqrt() * off)
    too_long = ((hips - ankle).norm(dim=-1) > longest)[..., None]
    weight = spread(toes[..., None].to(ankle.dtype), toes, LANDING_FRAMES)
    return torch.where(too_long, ankle + weight * (lifted - ankle), ankle)
