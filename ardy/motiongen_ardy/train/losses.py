"""Losses of the paper (section 3.4, implementation details) and of kinematics, each a mean over valid entries.

They are evaluated in float32, whatever precision the networks multiply in: half a per cent of a metre, the rounding
error of bfloat16, is larger than the errors to be measured.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from motiongen_ardy.core.constants import constant, index
from motiongen_ardy.core.representation import Representation


def masked_mean(values: Tensor, valid: Tensor) -> Tensor:
    """Mean of values (B, T, ...) over the frames or tokens where valid (B, T) is true."""
    weight = valid.to(values.dtype).view(*valid.shape, *([1] * (values.dim() - valid.dim())))
    return (values * weight).sum() / (weight.sum() * values[0, 0].numel()).clamp(min=1)


def smooth_l1(prediction: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Smooth L1 (Girshick 2015) over valid (B, T) of (B, T, C)."""
    return masked_mean(functional.smooth_l1_loss(prediction, target, reduction="none"), valid)


def length(vectors: Tensor) -> Tensor:
    """Euclidean norm (...) of (..., C), differentiable at zero."""
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
    """A pose in world units, from the rotations and the root of features.

    columns: (2, 3, B, T, J), the first two columns of the global rotation matrices; positions: (3, B, T, J) metres.
    Components come first, so that arithmetic runs over long rows; as last dimension, they would cost several times
    more.
    """

    columns: Tensor
    positions: Tensor


def dot(first: Tensor, second: Tensor) -> Tensor:
    """Scalar product (...) of vectors (3, ...)."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def cross(first: Tensor, second: Tensor) -> Tensor:
    """Vector product of vectors (3, ...)."""
    return torch.stack(
        [
            first[1] * second[2] - first[2] * second[1],
            first[2] * second[0] - first[0] * second[2],
            first[0] * second[1] - first[1] * second[0],
        ]
    )


def distance(vectors: Tensor) -> Tensor:
    """Length (...) of vectors (3, ...), differentiable at zero."""
    return (dot(vectors, vectors) + 1e-12).sqrt()


def unit(vectors: Tensor) -> Tensor:
    """Vectors (3, ...) scaled to length 1."""
    return vectors / distance(vectors)


def kinematics(representation: Representation, features: Tensor) -> Kinematics:
    """Rotations and positions of features (B, T, D) in natural units, computed from their rotations and root.

    The 6-D form is orthonormalised as in `motiongen_ardy.core.rotation`; positions are sums over bones.
    """
    skeleton = representation.skeleton
    given = _components(features[..., representation.rotation_block], 6)
    x = unit(given[:3])
    z = unit(cross(x, given[3:]))
    y = cross(z, x)
    parents = index(tuple(max(parent, 0) for parent in skeleton.parents), features.device)
    offsets = constant(skeleton.offset_rows, features.dtype, features.device)
    bones = sum(column.index_select(-1, parents) * offsets[:, axis] for axis, column in enumerate((x, y, z)))
    chains = constant(skeleton.chain_rows, features.dtype, features.device)
    root = features[..., representation.root_position_block].movedim(-1, 0)[..., None]
    return Kinematics(torch.stack([x, y]), bones @ chains.T + root)


def captured_kinematics(representation: Representation, features: Tensor) -> Kinematics:
    """The same for captured features: orthonormal rotations, and positions that already agree with kinematics."""
    columns = _components(features[..., representation.rotation_block], 6).unflatten(0, (2, 3))
    return Kinematics(columns, _block_positions(representation, features))


def _components(block: Tensor, width: int) -> Tensor:
    """(B, T, J * width) -> (width, B, T, J)."""
    return block.unflatten(-1, (-1, width)).movedim(-1, 0).contiguous()


def _block_positions(representation: Representation, features: Tensor) -> Tensor:
    """World positions (3, B, T, J) from the position block of features (B, T, D) in natural units."""
    root = features[..., representation.root_position_block].movedim(-1, 0)[..., None]
    ground = torch.cat([root[:1], torch.zeros_like(root[:1]), root[2:]])
    others = _components(features[..., representation.position_block], 3) + ground
    return torch.cat([root, others], dim=-1)


def consistency(representation: Representation, features: Tensor, pose: Kinematics, valid: Tensor) -> Tensor:
    """Mean distance (m) between joint positions as predicted and by kinematics; features (B, T, D), natural units."""
    apart = distance(pose.positions - _block_positions(representation, features))
    return masked_mean(apart[..., 1:], valid)


class KinematicErrors(NamedTuple):
    """How far a motion is from another by kinematics.

    joints: mean distance of joints (m); ends: of hands and feet (m); speed: of all joints' velocities (m/s);
    planted: speed (m/s) of the foot joints where the true ones are in contact; turn: distance of the rotation matrices'
    columns (unitless), which also detects a limb twisted about its own axis.
    """

    joints: Tensor
    ends: Tensor
    speed: Tensor
    planted: Tensor
    turn: Tensor


def kinematic_errors(
    representation: Representation, pose: Kinematics, true: Kinematics, contacts: Tensor, valid: Tensor
) -> KinematicErrors:
    """Errors of a pose by kinematics. contacts: (B, T, 4), of the true motion; valid: (B, T) bool."""
    skeleton = representation.skeleton
    apart = pose.positions - true.positions
    error = distance(apart)
    ends = index((*skeleton.left_hand, *skeleton.right_hand, *skeleton.left_foot, *skeleton.right_foot), error.device)
    both = valid[:, 1:] & valid[:, :-1]
    drift = distance(apart[:, :, 1:] - apart[:, :, :-1]) * representation.fps
    feet = index(tuple(skeleton.contact_joints), error.device)
    planted = (contacts[:, 1:] > 0.5) & (contacts[:, :-1] > 0.5) & both[..., None]
    turn = pose.columns - true.columns
    return KinematicErrors(
        joints=masked_mean(error, valid),
        ends=masked_mean(error.index_select(-1, ends), valid),
        speed=masked_mean(drift, both),
        planted=(drift.index_select(-1, feet) * planted).sum() / planted.sum().clamp(min=1),
        turn=masked_mean((turn.square().sum((0, 1)) + 1e-12).sqrt(), valid),
    )
