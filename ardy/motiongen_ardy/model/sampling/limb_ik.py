"""Inverse kinematics of limbs: bends a leg or an arm so that its end comes as near to a target as it can."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.two_bone import across, bent_to, unit

SOFT_REACH = 0.985
FULL_REACH = 0.995
LEAST_BEND = 1.02  # times the difference of the bone lengths, so that the middle joint never folds flat
POLE_WEIGHT_M = 2e-3  # weight of the neutral bend against the pose's own, as a distance off the straight line


def soft_reach(distance: Tensor, length: Tensor | float) -> Tensor:
    """A distance from the limb's origin, compressed to approach 99.5 % of the limb's length without reaching it.

    Below 98.5 % it is unchanged. The bend of the middle joint changes fastest just before the limb is straight; without
    the compression a knee would snap there.
    """
    start, room = SOFT_REACH * length, (FULL_REACH - SOFT_REACH) * length
    beyond = (distance - start).clamp(min=0)
    return torch.minimum(distance, start + room * (1 - torch.exp(-beyond / room)))


def bend(
    joints: tuple[Tensor, Tensor, Tensor],
    rotations: tuple[Tensor, Tensor],
    target: Tensor,
    pole: Tensor,
    hinged: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Bend a limb so that its end comes to `target`, in the plane in which it is already bent.

    joints, rotations and result: as for `bent_to`. target: (..., 3); pole: (..., 3), the world direction toward which
    the middle joint bends if the limb is straight; hinged: (...), 1 for a limb that bends to that side only and is
    mirrored if it is bent to the other, 0 for one that may bend to any side. A target out of reach is approached along
    the straight line as far as `soft_reach` allows. The end joint's own rotation is left to the caller.
    """
    upper, middle, end = joints
    length_1, length_2 = (middle - upper).norm(dim=-1), (end - middle).norm(dim=-1)
    line = unit(end - upper)
    aim = target - upper
    wanted = aim.norm(dim=-1)
    straight = torch.minimum(wanted, (end - upper).norm(dim=-1))  # a limb that is already straighter may stay so
    distance = torch.maximum(soft_reach(wanted, length_1 + length_2), straight)
    distance = torch.maximum(distance, LEAST_BEND * (length_1 - length_2).abs() + 1e-4)
    direction = unit(torch.where(wanted[..., None] > 1e-6, aim, line))
    off, toward = across(middle - upper, line), across(pole, line)
    weight: Tensor | float = POLE_WEIGHT_M
    if hinged is not None:
        behind = -(off * toward).sum(dim=-1).clamp(max=0) / toward.square().sum(dim=-1).clamp(min=1e-8)
        weight = (POLE_WEIGHT_M + 2 * hinged * behind)[..., None]
    outward = unit(off + weight * toward)
    return bent_to(joints, rotations, direction, distance, outward)
