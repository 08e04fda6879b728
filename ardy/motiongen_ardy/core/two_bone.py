"""Analytic inverse kinematics of a two-bone limb: bends it so that its end reaches a position.

The caller decides how far a limb may stretch, and on which side its middle joint is.
"""

from __future__ import annotations

import torch
from torch import Tensor


def unit(vectors: Tensor) -> Tensor:
    """Vectors (..., 3) scaled to length 1; zero stays zero."""
    return vectors / vectors.norm(dim=-1, keepdim=True).clamp(min=1e-8)


def across(vectors: Tensor, axis: Tensor) -> Tensor:
    """The component of vectors (..., 3) perpendicular to unit axes (..., 3)."""
    return vectors - (vectors * axis).sum(-1, keepdim=True) * axis


def swing(before: Tensor, after: Tensor) -> Tensor:
    """The smallest rotation (..., 3, 3) that turns unit vectors `before` into `after` (..., 3).

    There is none for opposite vectors, where any axis would do; within a few milliradians of that, the result is not a
    rotation.
    """
    axis = torch.linalg.cross(before, after)
    cosine = (before * after).sum(-1)[..., None, None]
    x, y, z = axis.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    identity = torch.eye(3, dtype=before.dtype, device=before.device)
    return identity + cross + cross @ cross / (1 + cosine).clamp(min=1e-6)


def _frame(direction: Tensor, normal: Tensor) -> Tensor:
    """(..., 3, 3) with columns: a bone's direction, the normal of the bend plane, and their cross product."""
    normal = unit(across(normal, direction))
    return torch.stack([direction, normal, torch.linalg.cross(direction, normal)], dim=-1)


def bent_to(
    joints: tuple[Tensor, Tensor, Tensor],
    rotations: tuple[Tensor, Tensor],
    direction: Tensor,
    distance: Tensor,
    outward: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A limb with its end `distance` (...) metres from its upper joint along the unit vector `direction` (..., 3).

    joints: world positions (..., 3) in metres of the upper, middle and end joint; rotations: global rotations
    (..., 3, 3) of the upper and middle joint. outward: (..., 3), a unit vector perpendicular to the line from upper to
    end joint, toward the side on which the middle joint is. The middle joint stays on that side. Both bones turn with
    the plane of the bend, and twist no more than it does. `distance` must be one that the bones can span. Returns both
    new rotations and the new positions of the middle and end joint.
    """
    upper, middle, end = joints
    first, second = middle - upper, end - middle
    length_1, length_2 = first.norm(dim=-1), second.norm(dim=-1)
    line = unit(end - upper)
    carried = unit(across((swing(line, direction) @ outward[..., None]).squeeze(-1), direction))
    along = (distance.square() + length_1.square() - length_2.square()) / (2 * distance)
    height = (length_1.square() - along.square()).clamp(min=0).sqrt()
    new_middle = upper + along[..., None] * direction + height[..., None] * carried
    new_end = upper + distance[..., None] * direction
    # Before and after, and both bones, are stacked: with few limbs, the number of calls determines the time.
    normals = torch.linalg.cross(torch.stack([line, direction]), torch.stack([outward, carried]))
    bones = torch.stack([first, second, new_middle - upper, new_end - new_middle]).unflatten(0, (2, 2))
    before, after = _frame(unit(bones), normals[:, None])
    turned = after @ before.transpose(-1, -2) @ torch.stack(rotations)
    return turned[0], turned[1], new_middle, new_end
