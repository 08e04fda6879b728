"""Feet: whether they slide, float or sink, and when they lift."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.evaluate.measures.root import MOVING_M_S, ground_speed, smoothed

LIFT_M = 0.025
# In a slow walk, toes rise by only 1.5 cm; this lower threshold distinguishes a first step from a body that leans.
STEP_M = 0.01
LOW_M = 0.05
SKATE_M = 0.025
GLIDE_M_S = 0.5


def foot_joints(skeleton: Skeleton, positions: Tensor) -> Tensor:
    """(T, 4, 3): left heel, left toe, right heel, right toe."""
    return positions[:, list(skeleton.contact_joints)]


def foot_speeds(skeleton: Skeleton, positions: Tensor, fps: int) -> Tensor:
    """(T-1, 4) metres a second over the ground."""
    feet = foot_joints(skeleton, positions)[..., [0, 2]]
    return (feet[1:] - feet[:-1]).norm(dim=-1) * fps


def slowest_foot(skeleton: Skeleton, positions: Tensor, fps: int) -> float:
    """The slowest foot joint's speed over the root's, median of frames in which the root moves; nan if there are none.

    0 is a foot that stays where it is put, 1 a statue that is pushed.
    """
    if len(positions) < 3:
        return math.nan
    root = ground_speed(positions[:, 0, [0, 2]], fps)
    moving = root > MOVING_M_S
    if not bool(moving.any()):
        return math.nan
    slowest = foot_speeds(skeleton, positions, fps).amin(dim=-1)
    return float((slowest[moving] / root[moving]).median())


def glide_share(skeleton: Skeleton, positions: Tensor, fps: int) -> float:
    """The share of frames in which even the slowest foot joint is faster than 0.5 m/s."""
    return float((foot_speeds(skeleton, positions, fps).amin(dim=-1) > GLIDE_M_S).float().mean())


def skate_in_contact(skeleton: Skeleton, positions: Tensor, contacts: Tensor, fps: int) -> float:
    """The mean speed, m/s, of foot joints while labelled (T, 4) bool as in contact; nan if none is."""
    speeds = foot_speeds(skeleton, positions, fps)
    labelled = contacts[:-1]
    return float(speeds[labelled].mean()) if bool(labelled.any()) else math.nan


def skating_ratio(skeleton: Skeleton, positions: Tensor) -> float:
    """The share of frames in which a toe below 5 cm moves more than 2.5 cm to the next frame."""
    toes = foot_joints(skeleton, positions)[:, [1, 3]]
    low = (toes[1:, :, 1] < LOW_M) & (toes[:-1, :, 1] < LOW_M)
    far = (toes[1:] - toes[:-1])[..., [0, 2]].norm(dim=-1) > SKATE_M
    return float((low & far).any(dim=-1).float().mean())


def foot_height(skeleton: Skeleton, positions: Tensor) -> float:
    """The mean height in metres of the lower toe."""
    return float(foot_joints(skeleton, positions)[:, [1, 3], 1].amin(dim=-1).mean())


def penetration(skeleton: Skeleton, positions: Tensor) -> float:
    """The mean depth in metres of the lowest foot joint below the ground; 0 in frames in which it is above."""
    return float((-foot_joints(skeleton, positions)[..., 1].amin(dim=-1)).clamp(min=0).mean())


def lifted(skeleton: Skeleton, positions: Tensor, rest: Tensor, by_m: float = LIFT_M) -> Tensor:
    """(T, 2) bool: whether the left and right toe is more than by_m above its resting height (2), metres."""
    return foot_joints(skeleton, positions)[:, [1, 3], 1] > rest + by_m


class FirstLift(NamedTuple):
    """Seconds until the first foot is lifted, and metres until then: of the root, and of the slowest foot joint."""

    seconds: float
    root_m: float
    glided_m: float


def first_lift(skeleton: Skeleton, positions: Tensor, from_frame: int, fps: int) -> FirstLift:
    """The first lifted foot from from_frame on. Without one, everything up to the end counts.

    A toe's resting height is its mean over the half second before. A root that moves over feet that stay in place is
    leaning, not gliding: gliding is the movement of the slowest foot.
    """
    rest = foot_joints(skeleton, positions[max(0, from_frame - fps // 2) : from_frame])[:, [1, 3], 1].mean(dim=0)
    frames = lifted(skeleton, positions[from_frame:], rest, STEP_M).any(dim=-1).nonzero()[:, 0]
    count = int(frames[0]) if len(frames) else len(positions) - 1 - from_frame
    before = positions[from_frame - 1 : from_frame + count]
    if len(before) < 2:
        return FirstLift(count / fps, 0.0, 0.0)
    root = (before[1:, 0] - before[:-1, 0])[:, [0, 2]].norm(dim=-1).sum()
    slowest = foot_speeds(skeleton, before, fps).amin(dim=-1).sum() / fps
    return FirstLift(count / fps, float(root), float(slowest))


def stop(skeleton: Skeleton, positions: Tensor, from_frame: int, fps: int) -> tuple[float, int]:
    """Seconds from from_frame until the root stays below 0.15 m/s, and how often a toe is lifted in that time."""
    speed = ground_speed(positions[:, 0, [0, 2]], fps)[from_frame:]
    fast = (speed > 0.15).nonzero()[:, 0]
    count = int(fast[-1]) + 1 if len(fast) else 0
    rest = torch.full((2,), float(foot_joints(skeleton, positions)[:, [1, 3], 1].quantile(0.1)))
    up = lifted(skeleton, positions[from_frame : from_frame + count + 1], rest)
    return count / fps, int((up[1:] & ~up[:-1]).sum()) if count else 0


def swivelled(skeleton: Skeleton, positions: Tensor) -> float:
    """Metres that toes move over the ground while not lifted, mean of both: 0 for a character that turns in steps.

    A toe's resting height is its own lowest tenth.
    """
    toes = foot_joints(skeleton, positions)[:, [1, 3]]
    low = ~lifted(skeleton, positions, toes[..., 1].quantile(0.1, dim=0))
    steps = (toes[1:] - toes[:-1])[..., [0, 2]].norm(dim=-1)
    return float((steps * (low[1:] & low[:-1])).sum(dim=0).mean())


def foot_trace(skeleton: Skeleton, positions: Tensor) -> Tensor:
    """(T, 2) heights in metres of the left and right toe, lightly smoothed, for drawing."""
    return smoothed(foot_joints(skeleton, positions)[:, [1, 3], 1], 3)
