"""Mirrors a motion in the plane x = 0: left becomes right, and right becomes left."""

from __future__ import annotations

import re
from functools import lru_cache

import torch
from torch import Tensor

from motiongen_ardy.core.skeleton import Skeleton

_SIDES = {"left": "right", "right": "left", "Left": "Right", "Right": "Left"}


class NoMirrorJoint(ValueError):
    """Raised for a skeleton in which a left or right joint has no counterpart."""


@lru_cache
def mirrored_joints(skeleton: Skeleton) -> tuple[int, ...]:
    """For each joint, the index of its counterpart on the other side (itself for a joint in the middle).

    Sides are read from joint names that start with left or right. Raises NoMirrorJoint if a counterpart is missing.
    """
    counterparts = []
    for name in skeleton.joint_names:
        other = re.sub(r"^(left|right|Left|Right)(?=[A-Z_])", lambda side: _SIDES[side.group(0)], name)
        if other not in skeleton.joint_names:
            raise NoMirrorJoint(f"skeleton {skeleton.name} has joint {name!r} but no {other!r} to mirror it with")
        counterparts.append(skeleton.joint_names.index(other))
    return tuple(counterparts)


def mirror_clip(skeleton: Skeleton, quaternions: Tensor, root_positions: Tensor) -> tuple[Tensor, Tensor]:
    """The mirror image of a motion: quaternions (..., J, 4) as (w, x, y, z), root positions (..., 3) metres.

    A rotation R becomes S R S with S = diag(-1, 1, 1), which is (w, x, -y, -z) as a quaternion; this holds for
    parent-relative and for global rotations.
    """
    turned = quaternions.new_tensor([1.0, 1.0, -1.0, -1.0])
    moved = root_positions.new_tensor([-1.0, 1.0, 1.0])
    joints = torch.tensor(mirrored_joints(skeleton), device=quaternions.device)
    return quaternions.index_select(-2, joints) * turned, root_positions * moved
