"""Limbs: the two-bone chains of a skeleton that can be bent to place a foot or a hand."""

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
    """One leg or arm. upper, middle, end: hip, knee, ankle or shoulder, elbow, wrist; joints below `end` move with it.

    tip: the next joint of the chain; beyond: all joints below `end`. upper_m, lower_m: bone lengths in metres. pole:
    where the middle joint of a straight limb bends to, in the neutral pose; hinged: it bends to no other side.
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
    """All joints below a joint, without itself."""
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
    """The left and right leg. Raises ConfigError for a skeleton whose legs are not hip, knee and ankle.

    A robot's leg is a chain of joints with one axis each, which a two-bone solution would turn about other axes.
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
    """The left and right arm, from shoulder to wrist. Raises ConfigError as `legs` does."""
    legs(skeleton)
    chains = (skeleton.left_hand, skeleton.right_hand)
    left, right = (_limb(skeleton, chain, (0.0, 0.0, -1.0), hinged=False) for chain in chains)
    return left, right


def limb_joints(limbs: tuple[Limb, ...], device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Index tensors (n) of the limbs' upper, middle and end joints, on a device."""
    upper, middle, end = (tuple(getattr(limb, name) for limb in limbs) for name in ("upper", "middle", "end"))
    return index(upper, device), index(middle, device), index(end, device)


def head_chain(skeleton: Skeleton) -> tuple[int, ...]:
    """The joints from the one above the root up to the head; empty for a skeleton without a joint called Head."""
    if "Head" not in skeleton.joint_names:
        return ()
    chain = [skeleton.index("Head")]
    while skeleton.parents[chain[0]] > 0:
        chain.insert(0, skeleton.parents[chain[0]])
    return tuple(chain)
