"""Twist: a standing foot keeps its direction while the body turns over it, and its leg twists to follow."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.rotation import angle_of, axis_angle_to_matrix, rotation_y
from motiongen_ardy.model.sampling.limbs import Limb, limb_joints
from motiongen_ardy.model.sampling.pose import Poses

# The share of a foot's twist that the whole leg takes, from the hip on; the ankle takes the rest.
LEG_SHARE = 0.7


def twist(standing: Tensor, sole: Tensor) -> Tensor:
    """How far (B, T, 2), in radians, each foot has turned over the ground since the first frame while it stood.

    standing: (B, T, 2) bool; sole: (B, T, 2, 3), metres, from heel to toe.
    """
    step = wrapped_steps(angle_of(sole[..., 0], sole[..., 2]))
    turned = (step * (standing[:, 1:] & standing[:, :-1])).cumsum(dim=1)
    return torch.cat([torch.zeros_like(turned[:, :1]), turned], dim=1)


def wrapped_steps(angle: Tensor) -> Tensor:
    """Changes (B, T - 1, ...) of angles (B, T, ...) from frame to frame, in -pi..pi."""
    step = angle[:, 1:] - angle[:, :-1]
    return angle_of(step.sin(), step.cos())


def turned_about_up(vectors: Tensor, angle: Tensor) -> Tensor:
    """Vectors (..., 3) turned by angles (...) about +Y."""
    return (rotation_y(angle) @ vectors[..., None]).squeeze(-1)


def turn_legs(poses: Poses, limbs: tuple[Limb, Limb], positions: Tensor, angle: Tensor) -> Tensor:
    """Turn both legs of poses (B, T) about the lines from ankle to hip by their share of angles (B, T, 2).

    positions: (B, T, J, 3), from `Poses.positions`. Returns them with the new positions of the knees.
    """
    upper, middle, end = limb_joints(limbs, positions.device)
    hips = positions[:, :, upper]
    line = hips - positions[:, :, end]
    axis = line / line.norm(dim=-1, keepdim=True).clamp(min=1e-8)
    turn = axis_angle_to_matrix(LEG_SHARE * angle[..., None] * axis)
    poses.turn([limb.upper for limb in limbs] + [limb.middle for limb in limbs], torch.cat([turn, turn], dim=2))
    turned = positions.clone()
    turned[:, :, middle] = hips + (turn @ (positions[:, :, middle] - hips)[..., None]).squeeze(-1)
    return turned
