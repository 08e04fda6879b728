"""Figures of motion: errors in metres, speeds in metres a second."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.representation import Representation


def joint_error(layout: Representation, features: Tensor, reference: Tensor) -> Tensor:
    """Mean distance (B) in metres between the joints of two motions (B, T, D), by kinematics of their rotations."""
    return (layout.positions(features) - layout.positions(reference)).norm(dim=-1).mean(dim=(-1, -2))


def foot_sliding(layout: Representation, features: Tensor) -> Tensor:
    """Mean ground speed (m/s) of foot joints while they are labelled as in contact, over all of (B, T, D)."""
    positions = layout.positions(features)[..., list(layout.skeleton.contact_joints), :]
    contact = features[:, :-1, layout.contact_block] > 0.5
    speed = (positions[:, 1:] - positions[:, :-1])[..., [0, 2]].norm(dim=-1) * layout.fps
    return speed[contact].mean() if bool(contact.any()) else torch.tensor(0.0)


def travel(features: Tensor) -> Tensor:
    """Distance (B) in metres over the ground between first and last frame of (B, T, D)."""
    return (features[:, -1, [0, 2]] - features[:, 0, [0, 2]]).norm(dim=-1)


def hand_raised(layout: Representation, features: Tensor, side: str) -> Tensor:
    """Whether (B) the "left" or "right" hand is above its shoulder for at least a quarter of a second of (B, T, D)."""
    skeleton = layout.skeleton
    hand = (skeleton.left_hand if side == "left" else skeleton.right_hand)[0]
    shoulder = skeleton.parents[skeleton.parents[hand]]
    positions = layout.positions(features)
    above = positions[..., hand, 1] > positions[..., shoulder, 1]
    return above.sum(dim=1) >= layout.fps // 4
