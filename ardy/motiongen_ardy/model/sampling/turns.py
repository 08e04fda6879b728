"""The rotations that bring a pose's joints onto their goals, frame by frame, before they are spread over time."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from motiongen_ardy.core.rotation import rotation_vector
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.core.two_bone import swing, unit
from motiongen_ardy.model.sampling.joint_goals import JointGoals
from motiongen_ardy.model.sampling.limbs import arms, head_chain, legs

# Shares of a head's turn that neck and trunk take, from the joint below the head downwards.
HEAD_SHARES = (0.5, 0.25, 0.15, 0.08, 0.04)


@lru_cache
def _bones(skeleton: Skeleton) -> tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int, int], ...]]:
    """(joint, child) for every bone, and (joint, child, other child) for joints with several children."""
    children: dict[int, list[int]] = {}
    for child, parent in enumerate(skeleton.parents[1:], 1):
        children.setdefault(parent, []).append(child)
    single = tuple((joint, child) for joint, found in children.items() for child in found)
    double = tuple((joint, found[0], other) for joint, found in children.items() for other in found[1:])
    return single, double


def _basis(along: Tensor, beside: Tensor) -> Tensor:
    """An orthonormal basis (..., 3, 3) from two vectors (..., 3) that are not parallel."""
    first = unit(along)
    third = unit(torch.linalg.cross(first, beside))
    return torch.stack([first, torch.linalg.cross(third, first), third], dim=-1)


def pose_turns(skeleton: Skeleton, goals: JointGoals, rotations: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
    """World rotation vectors (B, T, J, 3) that turn the joints onto their goals, and which joints (B, T, J) have one.

    rotations, positions: of the poses, (B, T, J, 3, 3) global and (B, T, J, 3). A joint turns as its rotation goal
    says; otherwise so that bones whose both ends have position goals point along these; otherwise with its parent,
    except the hips. A head turns neck and trunk with it.
    """
    turns = torch.zeros_like(positions)
    known = torch.zeros_like(goals.has_position)
    has, asked = goals.has_position, goals.positions
    single, double = _bones(skeleton)
    if bool(has.any()):
        joints, children = ([bone[end] for bone in single] for end in range(2))
        now = unit(positions[:, :, children] - positions[:, :, joints])
        then = unit(asked[:, :, children] - asked[:, :, joints])
        swings = rotation_vector(swing(now, then))
        for index, (joint, child) in enumerate(single):
            both = has[:, :, joint] & has[:, :, child]
            turns[:, :, joint] = torch.where(
                (both & ~known[:, :, joint])[..., None], swings[:, :, index], turns[:, :, joint]
            )
            known[:, :, joint] |= both
        joints, first, second = ([bone[end] for bone in double] for end in range(3))
        pair = [
            _basis(place[:, :, first] - place[:, :, joints], place[:, :, second] - place[:, :, joints])
            for place in (positions, asked)
        ]
        whole = rotation_vector(pair[1] @ pair[0].transpose(-1, -2))
        for index, (joint, child, other) in enumerate(double):
            all_three = has[:, :, joint] & has[:, :, child] & has[:, :, other]
            turns[:, :, joint] = torch.where(all_three[..., None], whole[:, :, index], turns[:, :, joint])
        _lean(skeleton, goals, positions, turns, known)
    own = rotation_vector(goals.rotations @ rotations.transpose(-1, -2))
    turns = torch.where(goals.has_rotation[..., None], own, turns)
    _share(skeleton, goals, turns, known)
    known = known | goals.has_rotation
    for joint in range(1, skeleton.num_joints):
        if joint not in skeleton.hip_joints:
            parent = skeleton.parents[joint]
            follows = known[:, :, parent] & ~known[:, :, joint]
            turns[:, :, joint] = torch.where(follows[..., None], turns[:, :, parent], turns[:, :, joint])
            known[:, :, joint] |= follows
    return turns, known


def _lean(skeleton: Skeleton, goals: JointGoals, positions: Tensor, turns: Tensor, known: Tensor) -> None:
    """A position goal of a trunk or head joint alone: the trunk leans toward it, about the joint above the root."""
    chain = head_chain(skeleton)
    for joint in chain[1:]:
        alone = goals.has_position[:, :, joint] & ~known[:, :, chain[0]]
        base = positions[:, :, chain[0]]
        lean = rotation_vector(swing(unit(positions[:, :, joint] - base), unit(goals.positions[:, :, joint] - base)))
        for below in chain[: chain.index(joint)]:
            free = alone & ~known[:, :, below]
            turns[:, :, below] = torch.where(free[..., None], lean, turns[:, :, below])
            known[:, :, below] |= free


def _share(skeleton: Skeleton, goals: JointGoals, turns: Tensor, known: Tensor) -> None:
    """Neck and trunk take their share of a head's turn, unless they have goals of their own."""
    chain = head_chain(skeleton)
    for joint, share in zip(reversed(chain[:-1]), HEAD_SHARES, strict=False):
        free = goals.has_rotation[:, :, chain[-1]] & ~known[:, :, joint] & ~goals.has_rotation[:, :, joint]
        turns[:, :, joint] = torch.where(free[..., None], share * turns[:, :, chain[-1]], turns[:, :, joint])
        known[:, :, joint] |= free


def middle_turns(skeleton: Skeleton, goals: JointGoals, positions: Tensor) -> tuple[Tensor, Tensor]:
    """For legs and arms: rotation vectors (B, T, 4, 3) of the upper joints that bring knees and elbows onto their
    goals, and where (B, T, 4) there are any.
    """
    limbs = (*legs(skeleton), *arms(skeleton))
    upper, middle = [limb.upper for limb in limbs], [limb.middle for limb in limbs]
    now = unit(positions[:, :, middle] - positions[:, :, upper])
    known = goals.has_position[:, :, middle]
    then = unit(torch.where(known[..., None], goals.positions[:, :, middle] - positions[:, :, upper], now))
    return rotation_vector(swing(now, then)), known
