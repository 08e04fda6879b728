"""JointGoals: the goals of joints at the frames of a window, as world positions in metres and global rotations."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from motiongen_ardy.core.constants import constant
from motiongen_ardy.core.representation import ON_GROUND, Representation
from motiongen_ardy.core.rotation import matrix_from_6d

MET_M = 2e-3


@dataclass(frozen=True)
class JointGoals:
    """Goals of B rows at T frames, each with a mask of where it applies.

    has_ground: (B, T), where the root's ground position is asked for. height: (B, T), of the root, metres; positions:
    (B, T, J, 3), world; rotations: (B, T, J, 3, 3), global.
    """

    has_ground: Tensor
    height: Tensor
    has_height: Tensor
    positions: Tensor
    has_position: Tensor
    rotations: Tensor
    has_rotation: Tensor

    def root_met(self, root: Tensor) -> Tensor:
        """Whether (B, T) a root (B, T, 3) is exactly on a goal; planned positions are only approached."""
        distance = (root - self.positions[:, :, 0])[..., 0::2].norm(dim=-1)
        return self.has_ground & (distance < MET_M)

    def after_history(self, known: bool) -> JointGoals:
        """The same with a frame before it: the history's, without goals, if known; else a copy of the first."""
        parts = [getattr(self, one.name) for one in fields(self)]
        return JointGoals(
            *(torch.cat([_without_goals(part[:, :1]) if known else part[:, :1], part], dim=1) for part in parts)
        )

    @property
    def any(self) -> bool:
        return bool((self.has_height.any() | self.has_position[:, :, 1:].any() | self.has_rotation.any()).item())


def _without_goals(part: Tensor) -> Tensor:
    """The frame (B, 1, ...) with all masks off; values stay as they are, so that rotations remain rotations."""
    return torch.zeros_like(part) if part.dtype == torch.bool else part


def joint_goals(layout: Representation, observed: Tensor, mask: Tensor) -> JointGoals:
    """The goals in observed features (B, G, D), normalised, with their mask.

    A joint's position is observed relative to the ground under the root, which is observed with it.
    """
    joints = layout.skeleton.num_joints
    natural, asked = layout.denormalize(observed), mask > 0
    root = natural[..., layout.root_position_block]
    ground = root * constant(ON_GROUND, root.dtype, root.device)
    others = natural[..., layout.position_block].unflatten(-1, (joints - 1, 3)) + ground[..., None, :]
    on_ground = asked[..., 0] & asked[..., 2]
    has_others = asked[..., layout.position_block].unflatten(-1, (joints - 1, 3)).all(dim=-1) & on_ground[..., None]
    has_rotation = asked[..., layout.rotation_block].unflatten(-1, (joints, 6)).all(dim=-1)
    identity = torch.eye(3, device=natural.device, dtype=natural.dtype)
    sixd = natural[..., layout.rotation_block].unflatten(-1, (joints, 6))
    plain = torch.where(has_rotation[..., None], sixd, identity[:, :2].T.flatten())
    return JointGoals(
        has_ground=on_ground,
        height=root[..., 1],
        has_height=asked[..., 1],
        positions=torch.cat([root[..., None, :], others], dim=-2),
        has_position=torch.cat([(asked[..., 1] & on_ground)[..., None], has_others], dim=-1),
        rotations=matrix_from_6d(plain),
        has_rotation=has_rotation,
    )
