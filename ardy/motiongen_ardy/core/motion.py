"""Motion: poses over time, in metres and radians."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics


@dataclass(frozen=True)
class Motion:
    """Poses over time; every tensor may have leading batch dimensions.

    local_rotations: (..., T, J, 3, 3), parent-relative; joint 0 carries the root's world rotation.
    root_positions: (..., T, 3), metres.
    foot_contacts: (..., T, 4) bool: left heel, left toe, right heel, right toe.
    fps: frames a second.
    """

    local_rotations: Tensor
    root_positions: Tensor
    foot_contacts: Tensor
    fps: int

    @property
    def num_frames(self) -> int:
        return int(self.root_positions.shape[-2])

    def positions(self, skeleton: Skeleton) -> Tensor:
        """World joint positions (..., T, J, 3), metres."""
        return forward_kinematics(skeleton, self.local_rotations, self.root_positions)[1]

    def on_host(self) -> Motion:
        """A copy on the CPU, detached from autograd."""
        parts = (self.local_rotations, self.root_positions, self.foot_contacts)
        return Motion(*(part.detach().cpu() for part in parts), self.fps)

    def frames(self, first: int, end: int) -> Motion:
        """Frames first to end - 1."""
        return Motion(
            self.local_rotations[..., first:end, :, :, :],
            self.root_positions[..., first:end, :],
            self.foot_contacts[..., first:end, :],
            self.fps,
        )


def concatenate(parts: list[Motion]) -> Motion:
    """Join parts in time. Raises ValueError for an empty list, and for parts with different frame rates."""
    if not parts:
        raise ValueError("no motion to concatenate; give at least one part")
    rates = sorted({part.fps for part in parts})
    if len(rates) > 1:
        raise ValueError(f"parts of {', '.join(map(str, rates))} frames a second; resample them to one rate first")
    return Motion(
        torch.cat([part.local_rotations for part in parts], dim=-4),
        torch.cat([part.root_positions for part in parts], dim=-2),
        torch.cat([part.foot_contacts for part in parts], dim=-2),
        parts[0].fps,
    )
