"""Knees: hinges that bend but do not twist, so that a shin is twisted only as its thigh is.

Where a shin points shows in the position of the foot, but its twist about its own axis is in nothing but its rotation,
which a decoder may have learned badly: captured knees twist by less than 6 degrees in 98 frames of 100, decoded shins
can spin, and smoothing or holding them afterwards jerks the feet. Only the shins' own rotations change here.
"""

from __future__ import annotations

from torch import Tensor

from motiongen_ardy.core.constants import constant, index
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.core.two_bone import swing, unit


def hinge_knees(skeleton: Skeleton, rotations: Tensor) -> Tensor:
    """Global rotations (B, T, J, 3, 3) with every shin bent from its thigh by the smallest rotation.

    Skeletons whose legs are not thigh, shin and foot stay as they are.
    """
    found = _shins(skeleton)
    if not found:
        return rotations
    thighs, shins = (index(joints, rotations.device) for joints in found[:2])
    feet = tuple(skeleton.offset_rows[foot] for foot in found[2])
    along = unit(constant(feet, rotations.dtype, rotations.device))[..., None]
    thigh, shin = rotations[:, :, thighs], rotations[:, :, shins]
    hinged = rotations.clone()
    hinged[:, :, shins] = swing((thigh @ along).squeeze(-1), (shin @ along).squeeze(-1)) @ thigh
    return hinged


def _shins(skeleton: Skeleton) -> tuple[tuple[int, ...], ...]:
    """Thighs, shins and ankles of the legs that consist of one of each."""
    legs = []
    for chain in (skeleton.left_foot, skeleton.right_foot):
        shin = skeleton.parents[chain[0]]
        if skeleton.parents[shin] in skeleton.hip_joints:
            legs.append((skeleton.parents[shin], shin, chain[0]))
    return tuple(zip(*legs, strict=True))
