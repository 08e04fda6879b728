"""Accelerations, and jumps where windows or prompts meet."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

KINDS = ("position", "velocity", "acceleration")


def accelerations(positions: Tensor, fps: int) -> Tensor:
    """(T-2, J) m/s2 of joints (T, J, 3)."""
    return (positions[2:] - 2 * positions[1:-1] + positions[:-2]).norm(dim=-1) * fps**2


def differences(positions: Tensor, fps: int) -> Tensor:
    """(T-3, 3): the largest jump of any joint from frame to frame, of position (m), velocity (m/s), acceleration.

    Row k describes the step from frame k+1 to frame k+2.
    """
    velocity = (positions[1:] - positions[:-1]) * fps
    acceleration = (velocity[1:] - velocity[:-1]) * fps
    position = (positions[2:-1] - positions[1:-2]).norm(dim=-1).amax(dim=-1)
    change = (velocity[2:] - velocity[1:-1]).norm(dim=-1).amax(dim=-1)
    jerk = (acceleration[1:] - acceleration[:-1]).norm(dim=-1).amax(dim=-1)
    return torch.stack([position, change, jerk], dim=-1)


def seam_jumps(positions: Tensor, seams: Sequence[int], fps: int) -> Tensor:
    """(S, 3): the larger jump of the two steps around each seam, which is the first frame of a window."""
    rows = differences(positions, fps)
    inside = [seam for seam in seams if 3 <= seam <= len(positions) - 2]
    if not inside:
        return torch.zeros(0, 3)
    # The step into the seam is row seam - 2; the change of velocity just after it is one row later.
    return torch.stack([rows[seam - 2 : seam].amax(dim=0) for seam in inside])


def hardest_beside_root(positions: Tensor, fps: int) -> float:
    """The greatest acceleration, m/s2, of any joint of positions (T, J, 3) relative to the root's ground position."""
    ground = positions[:, :1] * positions.new_tensor([1.0, 0.0, 1.0])
    return float(accelerations(positions - ground, fps).max())
