"""Losses of the paper (section 3.4, implementation details) and of kinematics, each a mean over valid entries.

They are evaluated in float32 whatever precision the networks multiply in: half a per cent of a metre is more than the
errors that they shall see.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from ardy.constants import index
from ardy.representation import Representation
from ardy.skeleton import positions_from_global


def masked_mean(values: Tensor, valid: Tensor) -> Tensor:
    """Mean of values (B, T, ...) over the frames or tokens where valid (B, T) is true."""
    weight = valid.to(values.dtype).view(*valid.shape, *([1] * (values.dim() - valid.dim())))
    return (values * weight).sum() / (weight.sum() * values[0, 0].numel()).clamp(min=1)


def smooth_l1(prediction: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Smooth L1 (Girshick 2015) over valid (B, T) of (B, T, C)."""
    return masked_mean(functional.smooth_l1_loss(prediction, target, reduction="none"), valid)


def length(vectors: Tensor) -> Tensor:
    """Euclidean norm (...) of (..., C), with a gradient at zero."""
    return torch.linalg.vector_norm(vectors + 1e-8, dim=-1)


def skate(representation: Representation, features: Tensor, valid: Tensor) -> Tensor:
    """Speed (m/s) of foot joints weighted by their predicted contact; features (B, T, D) in natural units.

    Paper, equation for L_skate: sum of c_j |v_j| over sum of c_j. Contacts are clamped to 0..1 first, since a
    regression can leave that range.
    """
    joints = index(tuple(representation.skeleton.contact_joints), features.device)
    velocity = features[..., representation.velocity_block].unflatten(-1, (-1, 3)).index_select(-2, joints)
    contact = features[..., representation.contact_block].clamp(0, 1) * valid[..., None]
    return (contact * length(velocity)).sum() / contact.sum().clamp(min=1)


class Kinematics(NamedTuple):
    """What the rotations and the root of features say, in world units.

    rotations: (B, T, J, 3, 3) global; positions: (B, T, J, 3) metres.
    """

    rotations: Tensor
    positions: Tensor


def kinematics(representation: Representation, features: Tensor) -> Kinematics:
    """Joint rotations and positions of features (B, T, D) in natural units, by their rotations and their root."""
    rotations = representation.global_rotations(features)
    root = features[..., representation.root_position_block]
    return Kinematics(rotations, positions_from_global(representation.skeleton, rotations, root))


def consistency(representation: Representation, features: Tensor, pose: Kinematics, valid: Tensor) -> Tensor:
    """Mean distance (m) between predicted joint positions and kinematics of the predicted rotations.

    features: (B, T, D) in natural units; both sides are taken relative to the root's ground position.
    """
    root = features[..., None, representation.root_position_block]
    ground = torch.cat([root[..., :1], torch.zeros_like(root[..., :1]), root[..., 2:]], dim=-1)
    by_rotation = (pose.positions - ground)[..., 1:, :]
    by_position = features[..., representation.position_block].unflatten(-1, (-1, 3))
    return masked_mean(length(by_rotation - by_position), valid)


class KinematicErrors(NamedTuple):
    """How far a motion is from another by kinematics.

    joints: mean distance of joints (m); ends: of hands and feet (m); speed: of all joints' velocities (m/s);
    planted: speed (m/s) of the foot joints where the true ones are in contact; turn: distance of rotation matrices
    (their columns, unitless), which also sees a limb turned about itself.
    """

    joints: Tensor
    ends: Tensor
    speed: Tensor
    planted: Tensor
    turn: Tensor


def kinematic_errors(
    representation: Representation, pose: Kinematics, true: Kinematics, contacts: Tensor, valid: Tensor
) -> KinematicErrors:
    """Errors of a pose by kinematics. contacts: (B, T, 4) of the true motion; valid: (B, T) bool."""
    skeleton = representation.skeleton
    distance = length(pose.positions - true.positions)
    ends = index(
        (*skeleton.left_hand, *skeleton.right_hand, *skeleton.left_foot, *skeleton.right_foot), distance.device
    )
    both = valid[:, 1:] & valid[:, :-1]
    velocity = (pose.positions[:, 1:] - pose.positions[:, :-1]) * representation.fps
    true_velocity = (true.positions[:, 1:] - true.positions[:, :-1]) * representation.fps
    feet = index(tuple(skeleton.contact_joints), distance.device)
    slip = length(velocity.index_select(-2, feet) - true_velocity.index_select(-2, feet))
    planted = (contacts[:, 1:] > 0.5) & (contacts[:, :-1] > 0.5) & both[..., None]
    return KinematicErrors(
        joints=masked_mean(distance, valid),
        ends=masked_mean(distance.index_select(-1, ends), valid),
        speed=masked_mean(length(velocity - true_velocity), both),
        planted=(slip * planted).sum() / planted.sum().clamp(min=1),
        turn=masked_mean(length((pose.rotations - true.rotations).flatten(-2)), valid),
    )
