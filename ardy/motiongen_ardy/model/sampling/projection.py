"""Brings a predicted root onto its goals: what is missing at the goals is spread over the window as a smooth curve."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.core.rotation import angle_of
from motiongen_ardy.model.sampling.options import SamplingOptions

_NEVER_M = 1e9


@dataclass(frozen=True)
class RootProjection:
    """The goals of B rows over the T frames of their horizons, which begin at frame `first` of the window.

    ground, height, heading: (B, T, T), frame by goal: the curve that each goal's correction makes. asked: (B, T, 4), x
    and z in metres in the window's frame, height, heading in radians without jumps between goals; where: (B, T, 3) 0 or
    1 for ground, height, heading. slack: (B, T, 2) metres and radians that may be missing. most: (B, T) metres, the
    greatest correction over the ground.
    """

    first: int
    ground: Tensor
    height: Tensor
    heading: Tensor
    asked: Tensor
    where: Tensor
    slack: Tensor
    most: Tensor

    def rows(self, index: Any) -> RootProjection:
        """The rows that an index of the first dimension chooses."""
        return RootProjection(self.first, *(part[index] for part in self._parts()))

    def _parts(self) -> list[Tensor]:
        return [getattr(self, one.name) for one in fields(self) if one.name != "first"]

    @staticmethod
    def stacked(rows: list[RootProjection]) -> RootProjection:
        """Single rows, whose tensors lack the first dimension, as one; `first` is of no more use."""
        parts = zip(*(row._parts() for row in rows), strict=True)
        return RootProjection(0, *(torch.stack(part) for part in parts))

    def none(self) -> RootProjection:
        """The same shape without goals."""
        return RootProjection(self.first, *(torch.zeros_like(part) for part in self._parts()))

    def apply(self, layout: Representation, root: Tensor, active: Tensor | None = None) -> Tensor:
        """A normalised root (B, T, 5) on its goals; rows without goals, or not active (B), stay bit for bit."""
        scale = layout.root_stats.scale
        natural = layout.root_stats.denormalize(root)
        where = self.where if active is None else self.where * active[:, None, None]
        missing = (self.asked[..., :2] - natural[..., [0, 2]]) * where[..., :1]
        length = missing.norm(dim=-1, keepdim=True)
        kept = torch.minimum((length - self.slack[..., :1]).clamp(min=0), self.most[..., None])
        ground = self.ground @ (missing * (kept / length.clamp(min=1e-9)))
        height = _product(self.height, (self.asked[..., 2] - natural[..., 1]) * where[..., 1])[..., None]
        turn = _product(self.heading, self._missing_heading(natural[..., 3:], where[..., 2]))
        cosine, sine = natural[..., 3], natural[..., 4]
        turned = torch.stack(
            [cosine * (turn.cos() - 1) - sine * turn.sin(), cosine * turn.sin() + sine * (turn.cos() - 1)], dim=-1
        )
        moved = torch.cat([ground[..., :1], height, ground[..., 1:], turned], dim=-1)
        return root + moved / scale

    def _missing_heading(self, cosine_sine: Tensor, where: Tensor) -> Tensor:
        """The turn (B, T) in radians that is missing at the goals, less what may be missing."""
        angle = angle_of(cosine_sine[..., 1], cosine_sine[..., 0])
        steps = wrap(angle[:, 1:] - angle[:, :-1])
        angle = torch.cat([angle[:, :1], angle[:, :1] + steps.cumsum(dim=1)], dim=1)
        off = self.asked[..., 3] - angle
        # From one goal to the next the way that is missing must not go once round: whole turns are those of the first.
        first = off.gather(1, where.argmax(dim=1, keepdim=True))
        off = (off - (first - wrap(first))) * where
        return off.sign() * (off.abs() - self.slack[..., 1]).clamp(min=0)


def _product(matrices: Tensor, vectors: Tensor) -> Tensor:
    """(B, T, T) with (B, T) -> (B, T), a sum for each row: a matrix product adds otherwise where B is 1."""
    return (matrices * vectors[:, None]).sum(dim=-1)


def wrap(angle: Tensor) -> Tensor:
    """Angles in -pi..pi."""
    return angle_of(angle.sin(), angle.cos())


def make_projection(
    layout: Representation,
    observed: Tensor,
    mask: Tensor,
    planned: Tensor | None,
    first: int,
    num_frames: int,
    options: SamplingOptions,
) -> RootProjection | None:
    """The projection of horizons that begin at frame `first` of windows; None where no root is constrained there.

    observed, mask: (B, T, D) normalised, in the windows' own frames. planned: (B, T, 2) bool, whose ground and whose
    heading may be missed by the slack; None for no such frames.
    """
    horizon = slice(first, first + num_frames)
    held = mask[:, horizon, :ROOT_WIDTH] != 0
    if not bool(held.any()):
        return None
    natural = layout.root_stats.denormalize(observed[:, horizon, :ROOT_WIDTH])
    where = held[..., [0, 1, 3]]
    known = where.cpu().numpy()
    angle = np.where(known[..., 2], torch.atan2(natural[..., 4], natural[..., 3]).cpu().numpy(), 0.0)
    for row, frames in zip(angle, known[..., 2], strict=True):
        row[frames] = np.unwrap(row[frames])
    curves = [
        torch.from_numpy(np.stack([goal_curves(tuple(np.flatnonzero(row).tolist()), num_frames) for row in kind]))
        for kind in (known[..., 0], known[..., 1], known[..., 2])
    ]
    slack = torch.zeros_like(natural[..., :2])
    if planned is not None:
        allowed = slack.new_tensor([options.projection.slack_m, options.projection.slack_rad])
        exact = (where[..., [0, 2]] & ~planned[:, horizon]).cpu()
        slack = _room(exact, options.projection.settle_frames).to(slack) * planned[:, horizon] * allowed
    most = torch.full_like(natural[..., 0], _NEVER_M)
    if not options.plan_root:  # a goal that the root cannot get to in time is missed, not jumped to
        seconds = torch.arange(1, num_frames + 1, device=most.device) / layout.fps
        most = torch.minimum(options.projection.acceleration_m_s2 * seconds**2 / 6, seconds / 1.5).expand_as(most)
    asked = torch.stack(
        [natural[..., 0], natural[..., 2], natural[..., 1], torch.from_numpy(angle).to(natural)], dim=-1
    )
    return RootProjection(first, *(curve.to(natural) for curve in curves), asked, where.to(natural.dtype), slack, most)


def _room(exact: Tensor, settle_frames: int) -> Tensor:
    """The share (B, T, 2) of its slack that each frame has: none at a goal (B, T, 2) that was asked for, all at
    settle_frames from it. A root that used its slack up to the frame before would be jerked onto the goal.
    """
    frames = torch.arange(exact.shape[1])
    away = (frames[:, None] - frames).abs().float()[None, :, :, None]  # from frame 1 to goal 2
    nearest = torch.where(exact[:, None], away, float(settle_frames)).amin(dim=2)
    return (nearest / settle_frames).clamp(max=1)


@lru_cache(maxsize=512)
def goal_curves(goals: tuple[int, ...], num_frames: int) -> np.ndarray:
    """(T, T): column g is the correction over all frames for 1 at goal g and 0 at the others; other columns are 0.

    A cubic spline with two smooth derivatives through the goals; zero and flat at the frame before the first, flat at
    the last goal, and after it as it is there.
    """
    curves = np.zeros((num_frames, num_frames))
    if not goals:
        return curves
    knots = np.array([0.0, *(goal + 1.0 for goal in goals)])
    values = np.eye(len(knots))[:, 1:]
    slopes = _spline_slopes(knots, values)
    time = np.minimum(np.arange(1.0, num_frames + 1.0), knots[-1])
    left = np.clip(np.searchsorted(knots, time, side="left") - 1, 0, len(knots) - 2)
    span = (knots[left + 1] - knots[left])[:, None]
    share = (time[:, None] - knots[left][:, None]) / span
    rise = share * share * (3.0 - 2.0 * share)
    curve = values[left] * (1.0 - rise) + values[left + 1] * rise
    curve += span * share * (1.0 - share) * (slopes[left] * (1.0 - share) - slopes[left + 1] * share)
    curves[:, list(goals)] = curve
    curves.setflags(write=False)
    return curves


def _spline_slopes(knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Slopes (K, C) of a cubic spline through values (K, C) that is flat at both ends."""
    count, gaps = len(knots), np.diff(knots)
    system, right = np.eye(count), np.zeros_like(values)
    rises = np.diff(values, axis=0) / gaps[:, None]
    for inner in range(1, count - 1):
        before, after = gaps[inner - 1], gaps[inner]
        system[inner, inner - 1 : inner + 2] = after, 2.0 * (before + after), before
        right[inner] = 3.0 * (after * rises[inner - 1] + before * rises[inner])
    slopes: np.ndarray = np.linalg.solve(system, right)
    return slopes
