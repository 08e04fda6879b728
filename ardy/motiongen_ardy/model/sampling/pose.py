"""Poses: a window's frames as global rotations and roots, for corrections in place, and back to features."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from motiongen_ardy.core.constants import constant, index
from motiongen_ardy.core.representation import ON_GROUND, Representation, contact_labels, velocities
from motiongen_ardy.core.rotation import matrix_to_6d
from motiongen_ardy.core.skeleton import positions_from_global
from motiongen_ardy.model.sampling.limb_ik import bend
from motiongen_ardy.model.sampling.limbs import Limb, limb_joints


class Poses:
    """Frames (B, T), changed in place.

    rotations: (B, T, J, 3, 3), global; root: (B, T, 3), metres; contacts: (B, T, 4), about 0 to 1, from the model.
    """

    def __init__(self, layout: Representation, rotations: Tensor, root: Tensor, contacts: Tensor) -> None:
        self.layout = layout
        self.rotations = rotations
        self.root = root
        self.contacts = contacts

    @classmethod
    def of(cls, layout: Representation, features: Tensor) -> Poses:
        """Poses of features (B, T, D) in natural units, which are not changed."""
        root = features[..., layout.root_position_block].clone()
        return cls(layout, layout.global_rotations(features), root, features[..., layout.contact_block])

    def only(self, frame: int) -> Poses:
        """One frame of them, as (B, 1)."""
        return Poses(self.layout, *(part[:, frame:][:, :1] for part in (self.rotations, self.root, self.contacts)))

    def then(self, later: Poses) -> Poses:
        """These poses followed by later ones."""
        mine, others = ((one.rotations, one.root, one.contacts) for one in (self, later))
        return Poses(self.layout, *(torch.cat(parts, dim=1) for parts in zip(mine, others, strict=True)))

    def positions(self) -> Tensor:
        """World positions (B, T, J, 3) of all joints, by forward kinematics."""
        return positions_from_global(self.layout.skeleton, self.rotations, self.root)

    def turn(self, joints: Sequence[int], delta: Tensor) -> None:
        """Turn joints (n) by world rotations (B, T, n or 1, 3, 3); their children keep their own global rotations."""
        if len(joints) == self.layout.skeleton.num_joints:
            self.rotations = delta @ self.rotations
        else:
            turned = index(tuple(joints), delta.device)
            self.rotations[:, :, turned] = delta @ self.rotations[:, :, turned]

    def turn_about_up(self, angle: Tensor) -> None:
        """Turn all joints by angles (B, T) in radians about +Y."""
        self.rotations = rotated_about_up(self.rotations, angle)

    def bend_limbs(
        self, limbs: Sequence[Limb], positions: Tensor, targets: Tensor, where: Tensor | None = None
    ) -> None:
        """Place the limbs' ends at targets (B, T, n, 3). positions: from `positions()`; where: (B, T, n or 1), all
        others stay exactly as they are.
        """
        upper, middle, end = limb_joints(tuple(limbs), positions.device)
        rotations = (self.rotations[:, :, upper], self.rotations[:, :, middle])
        neutral = constant(tuple(limb.pole for limb in limbs), positions.dtype, positions.device)
        pole = (rotations[0] @ neutral[..., None]).squeeze(-1)
        joints = (positions[:, :, upper], positions[:, :, middle], positions[:, :, end])
        hinged = constant(tuple(float(limb.hinged) for limb in limbs), positions.dtype, positions.device)
        first, second, _, _ = bend(joints, rotations, targets, pole, hinged)
        if where is not None:
            first, second = (
                torch.where(where[..., None, None], new, old)
                for new, old in zip((first, second), rotations, strict=True)
            )
        self.rotations[:, :, upper], self.rotations[:, :, middle] = first, second

    def features(self, heading: Tensor) -> Tensor:
        """Consistent features (B, T, D) in natural units: everything but the root's position and its heading (B, T, 2),
        cosine and sine, is computed from the poses by kinematics.
        """
        layout, positions = self.layout, self.positions()
        lengths = torch.full(heading.shape[:1], heading.shape[1], device=heading.device)
        velocity = velocities(positions, lengths, layout.fps)
        ground = self.root[..., None, :] * constant(ON_GROUND, self.root.dtype, self.root.device)
        return torch.cat(
            [
                self.root,
                heading,
                (positions[..., 1:, :] - ground).flatten(-2),
                matrix_to_6d(self.rotations).flatten(-2),
                velocity.flatten(-2),
                contact_labels(layout.skeleton, positions, velocity).to(heading.dtype),
            ],
            dim=-1,
        )


def rotated_about_up(rotations: Tensor, angle: Tensor) -> Tensor:
    """Rotations (B, T, J, 3, 3) turned by angles (B, T) in radians about +Y; equals products with `rotation_y`."""
    cosine, sine = torch.cos(angle)[..., None, None], torch.sin(angle)[..., None, None]
    x, y, z = rotations.unbind(-2)
    return torch.stack([cosine * x + sine * z, y, cosine * z - sine * x], dim=-2)
