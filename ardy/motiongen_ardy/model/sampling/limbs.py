"""Limbs: the two-bone chains of a skeleton that can be bent to put a foot or a hand somewhere."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constants import index
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.model.config import ConfigError


@dataclass(frozen=True)
class Limb:
    """One leg or arm. upper, middle, end: hip, knee, ankle or shoulder, elbow, wrist; all below `end` moves with it.

    upper_m, lower_m: bone lengths in metres. pole: where the middle joint bends to in the neutral pose, for a limb
    that is straight; hinged: it bends to no other side.
    """

    upper: int
    middle: int
    end: int
    tip: int
    beyond: tuple[int, ...]
    upper_m: float
    lower_m: float
    pole: tuple[float, float, float]
    hinged: bool

    @property
    def length_m(self) -> float:
        return self.upper_m + self.lower_m


def descendants(skeleton: Skeleton, joint: int) -> tuple[int, ...]:
    """The joints below a joint, not itself."""
    found = {joint}
    for child, parent in enumerate(skeleton.parents):
        if parent in found:
            found.add(child)
    return tuple(sorted(found - {joint}))


def _limb(skeleton: Skeleton, chain: tuple[int, ...], pole: tuple[float, float, float], *, hinged: bool) -> Limb:
    end, tip = chain[:2]
    middle = skeleton.parents[end]
    upper = skeleton.parents[middle]
    lengths = [float(np.linalg.norm(skeleton.offsets[joint])) for joint in (middle, end)]
    return Limb(upper, middle, end, tip, descendants(skeleton, end), *lengths, pole, hinged)


@lru_cache
def legs(skeleton: Skeleton) -> tuple[Limb, Limb]:
    """The left and the right leg. Raises ConfigError for a skeleton whose hips do not carry knee and ankle.

    A robot's leg has a chain of joints with an axis each, which a two-bone solution would turn about other axes.
    """
    found = tuple(
        _limb(skeleton, chain, (0.0, 0.0, 1.0), hinged=True) for chain in (skeleton.left_foot, skeleton.right_foot)
    )
    if {limb.upper for limb in found} != set(skeleton.hip_joints):
        raise ConfigError(
            f"skeleton {skeleton.name} has no legs of two bones between hip and ankle, which foot clean-up and joint"
            " goals bend; set clean_feet and reach_joints to false"
        )
    return found[0], found[1]


@lru_cache
def arms(skeleton: Skeleton) -> tuple[Limb, Limb]:
    """The left and the right arm, from shoulder to wrist. Raises ConfigError as `legs` does."""
    legs(skeleton)
    chains = (skeleton.left_hand, skeleton.right_hand)
    left, right = (_limb(skeleton, chain, (0.0, 0.0, -1.0), hinged=False) for chain in chains)
    return left, right


def limb_joints(limbs: tuple[Limb, ...], device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """The numbers (n) of their upper, middle and end joints, to select with on a device."""
    upper, middle, end = (tuple(getattr(limb, name) for limb in limbs) for name in ("upper", "middle", "end"))
    return index(upper, device), index(middle, device), index(end, device)


def head_chain(skeleton: Skeleton) -> tuple[int, ...]:
    """The joints from the one above the root up to the head; none for a skeleton without a joint called Head."""
    if "Head" not in skeleton.joint_names:
        return ()
    chain = [skeleton.index("Head")]
    while skeleton.parents[chain[0]] > 0:
        chain.insert(0, skeleton.parents[chain[0]])
    return tuple(chain)
