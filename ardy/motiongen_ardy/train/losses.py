"""Losses of the paper (section 3.4, implementation details), each a mean over valid entries."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from motiongen_ardy.representation import Representation
from motiongen_ardy.skeleton import positions_from_global


def masked_mean(values: Tensor, valid: Tensor) -> Tensor:
    """Mean of values (B, T, ...) over the frames or tokens where valid (B, T) is true."""
    weight = valid.to(values.dtype).view(*valid.shape, *([1] * (values.dim() - valid.dim())))
    return (values * weight).sum() / (weight.sum() * values[0, 0].numel()).clamp(min=1)


def smooth_l1(prediction: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Smooth L1 (Girshick 2015) over valid (B, T) of (B, T, C)."""
    return masked_mean(functional.smooth_l1_loss(prediction, target, reduction="none"), valid)


def skate(representation: Representation, features: Tensor, valid: Tensor) -> Tensor:
    """Speed (m/s) of foot joints weighted by their predicted contact; features (B, T, D) in natural units.

    Paper, equation for L_skate: sum of c_j |v_j| over sum of c_j. Contacts are clamped to 0..1 first, since a
    regression can leave that range.
    """
    joints = representation.skeleton.contact_joints
    velocity = features[..., representation.velocity_block].unflatten(-1, (-1, 3))[..., list(joints), :]
    contact = features[..., representation.contact_block].clamp(0, 1) * valid[..., None]
    speed = torch.linalg.vector_norm(velocity + 1e-8, dim=-1)
    return (contact * speed).sum() / contact.sum().clamp(min=1)


def consistency(representation: Representation, features: Tensor, valid: Tensor) -> Tensor:
    """Mean distance (m) between predicted joint positions and kinematics of the predicted rotations.

    features: (B, T, D) in natural units; both sides are taken relative to the root's ground position.
    """
    rotations = representation.global_rotations(features)
    height = features[..., :3] * features.new_tensor([0.0, 1.0, 0.0])
    by_rotation = positions_from_global(representation.skeleton, rotations, height)[..., 1:, :]
    by_position = features[..., representation.position_block].unflatten(-1, (-1, 3))
    return masked_mean(torch.linalg.vector_norm(by_rotation - by_position + 1e-8, dim=-1), valid)
