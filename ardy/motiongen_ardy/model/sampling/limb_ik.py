"""Analytic two-bone inverse kinematics: a leg or an arm is bent so that its end comes to a target."""

from __future__ import annotations

import torch
from torch import Tensor

SOFT_REACH = 0.985
FULL_REACH = 0.995
LEAST_BEND = 1.02  # of the difference of the bones, so that the middle joint never folds flat
POLE_WEIGHT_M = 2e-3  # how much the neutral bend counts beside the pose's own, as a distance off the straight line


def _unit(vectors: Tensor) -> Tensor:
    return vectors / vectors.norm(dim=-1, keepdim=True).clamp(min=1e-8)


def _across(vectors: Tensor, axis: Tensor) -> Tensor:
    """The part of vectors (..., 3) at right angles to unit axes (..., 3)."""
    return vectors - (vectors * axis).sum(-1, keepdim=True) * axis


def soft_reach(distance: Tensor, length: Tensor | float) -> Tensor:
    """A distance from the limb's origin, flattened so that it comes near 99.5 % of the limb's length and never to it.

    Below 98.5 % it is as it was. The bend of the middle joint is steepest just before the limb is straight; without
    the flattening a knee would snap there.
    """
    start, room = SOFT_REACH * length, (FULL_REACH - SOFT_REACH) * length
    beyond = (distance - start).clamp(min=0)
    return torch.minimum(distance, start + room * (1 - torch.exp(-beyond / room)))


def swing(before: Tensor, after: Tensor) -> Tensor:
    """The least rotation (..., 3, 3) that turns unit vectors `before` into `after` (..., 3).

    None for opposite ones, for which every axis would do.
    """
    axis = torch.linalg.cross(before, after)
    cosine = (before * after).sum(-1)[..., None, None]
    x, y, z = axis.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    identity = torch.eye(3, dtype=before.dtype, device=before.device)
    return identity + cross + cross @ cross / (1 + cosine).clamp(min=1e-6)


def _frame(direction: Tensor, normal: Tensor) -> Tensor:
    """(..., 3, 3) with columns: a bone's direction, the bend plane's normal, and what completes them."""
    normal = _unit(_across(normal, direction))
    return torch.stack([direction, normal, torch.linalg.cross(direction, normal)], dim=-1)


def bend(
    joints: tuple[Tensor, Tensor, Tensor], rotations: tuple[Tensor, Tensor], target: Tensor, pole: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Bend a limb so that its end comes to `target`, in the plane in which it is bent already.

    joints: world positions (..., 3) in metres of its upper, middle and end joint; rotations: global rotations
    (..., 3, 3) of upper and middle joint; target: (..., 3); pole: (..., 3), the world direction in which the middle
    joint goes where the limb is straight. Returns both new rotations and the new positions of middle and end; a target
    out of reach is approached along the straight line as near as `soft_reach` allows. The end's own rotation is the
    caller's.
    """
    upper, middle, end = joints
    first, second = middle - upper, end - middle
    length_1, length_2 = first.norm(dim=-1), second.norm(dim=-1)
    line = _unit(end - upper)
    aim = target - upper
    wanted = aim.norm(dim=-1)
    straight = torch.minimum(wanted, (end - upper).norm(dim=-1))  # a limb that is straighter already may stay so
    distance = torch.maximum(soft_reach(wanted, length_1 + length_2), straight)
    distance = torch.maximum(distance, LEAST_BEND * (length_1 - length_2).abs() + 1e-4)
    direction = _unit(torch.where(wanted[..., None] > 1e-6, aim, line))
    outward = _unit(_across(first, line) + POLE_WEIGHT_M * _across(pole, line))
    carried = _unit(_across((swing(line, direction) @ outward[..., None]).squeeze(-1), direction))
    along = (distance.square() + length_1.square() - length_2.square()) / (2 * distance)
    height = (length_1.square() - along.square()).clamp(min=0).sqrt()
    new_middle = upper + along[..., None] * direction + height[..., None] * carried
    new_end = upper + distance[..., None] * direction
    normal, new_normal = torch.linalg.cross(line, outward), torch.linalg.cross(direction, carried)
    turned = [
        _frame(_unit(after), new_normal) @ _frame(_unit(before), normal).transpose(-1, -2) @ rotation
        for before, after, rotation in (
            (first, new_middle - upper, rotations[0]),
            (second, new_end - new_middle, rotations[1]),
        )
    ]
    return turned[0], turned[1], new_middle, new_end
