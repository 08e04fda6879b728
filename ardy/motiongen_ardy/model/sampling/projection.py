"""Projects a predicted root onto its goals: the error at the goals is spread over the window as a smooth curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.core.rotation import angle_of
from motiongen_ardy.model.sampling.goal_curves import goal_curves
from motiongen_ardy.model.sampling.options import SamplingOptions
from motiongen_ardy.model.sampling.slowing import slowed

_NEVER_M = 1e9
SWAY_RAD_S = 1.0
"""How fast the deviation of a root from a heading that it may miss grows or shrinks at most."""


@dataclass(frozen=True)
class RootProjection:
    """The goals of B rows over the T frames of their horizons, which begin at frame `first` of the window.

    ground, height, heading: (B, T, T), frame by goal: the curve of each goal's correction.
    asked: (B, T, 4), x and z in metres in the window's frame, height, heading in radians without jumps between goals.
    where: (B, T, 3), 0 or 1 for ground, height, heading.
    slack: (B, T, 2), metres and radians by which a goal may be missed.
    most: (B, T), metres, the greatest correction over the ground.
    before: (B, 4), the root's position and velocity before the horizon, from `slowing.motion_before`; the velocity is
    zero for rows with ground goals.
    slowing_s: how long a velocity takes to fade.
    """

    first: int
    ground: Tensor
    height: Tensor
    heading: Tensor
    asked: Tensor
    where: Tensor
    slack: Tensor
    most: Tensor
    before: Tensor
    slowing_s: float

    def rows(self, index: Any) -> RootProjection:
        """The rows that an index into the first dimension selects."""
        return RootProjection(self.first, *(part[index] for part in self.tensors()), self.slowing_s)

    def tensors(self) -> list[Tensor]:
        """All tensors, in the order that `of_tensors` takes."""
        return [getattr(self, one.name) for one in fields(self) if one.name not in ("first", "slowing_s")]

    @staticmethod
    def of_tensors(parts: Sequence[Tensor], slowing_s: float) -> RootProjection:
        """From tensors as `tensors` returns them; `first` is then meaningless."""
        return RootProjection(0, *parts, slowing_s)

    @staticmethod
    def stacked(rows: list[RootProjection]) -> RootProjection:
        """Stack single rows, whose tensors lack the first dimension; `first` is then meaningless."""
        parts = zip(*(row.tensors() for row in rows), strict=True)
        return RootProjection.of_tensors([torch.stack(part) for part in parts], rows[0].slowing_s)

    def none(self) -> RootProjection:
        """A projection of the same shape without goals."""
        return RootProjection(self.first, *(torch.zeros_like(part) for part in self.tensors()), self.slowing_s)

    def leads(self, num_frames: int) -> Tensor:
        """Which rows (B) have ground and heading goals at each of the first num_frames frames, or all if fewer.

        Planned paths to waypoints leave the very first frame to the history, so rows with those are not led.
        """
        asked = self.where[..., :num_frames, :] != 0
        led: Tensor = asked[..., 0].all(dim=-1) & asked[..., 2].all(dim=-1)
        return led

    def apply(self, layout: Representation, root: Tensor, active: Tensor | None = None) -> Tensor:
        """A normalised root (B, T, 5) projected onto its goals; rows without goals, or not active (B), stay as is."""
        scale = layout.root_stats.scale
        natural = layout.root_stats.denormalize(root)
        where = self.where if active is None else self.where * active[:, None, None]
        carried = torch.zeros_like(natural[..., :2])
        if self.slowing_s:
            before = self.before if active is None else self.before * active[:, None]
            carried = slowed(natural[..., 0:3:2], before, self.slowing_s, layout.fps)
        missing = (self.asked[..., :2] - natural[..., 0:3:2] - carried) * where[..., :1]
        length = missing.norm(dim=-1, keepdim=True)
        kept = torch.minimum((length - self.slack[..., :1]).clamp(min=0), self.most[..., None])
        ground = carried + self.ground @ (missing * (kept / length.clamp(min=1e-9)))
        height = _product(self.height, (self.asked[..., 2] - natural[..., 1]) * where[..., 1])[..., None]
        turn = _product(self.heading, self._missing_heading(natural[..., 3:], where[..., 2], layout.fps))
        cosine, sine = natural[..., 3], natural[..., 4]
        turned = torch.stack(
            [cosine * (turn.cos() - 1) - sine * turn.sin(), cosine * turn.sin() + sine * (turn.cos() - 1)], dim=-1
        )
        moved = torch.cat([ground[..., :1], height, ground[..., 1:], turned], dim=-1)
        return root + moved / scale

    def _missing_heading(self, cosine_sine: Tensor, where: Tensor, fps: int) -> Tensor:
        """The turn (B, T) in radians that is missing at the goals, less the permitted slack.

        The slack changes slowly: a root that is predicted to look the other way lags by the whole slack, and would jump
        ahead by as much when it is predicted to turn round at once.
        """
        angle = angle_of(cosine_sine[..., 1], cosine_sine[..., 0])
        steps = wrap(angle[:, 1:] - angle[:, :-1])
        angle = torch.cat([angle[:, :1], angle[:, :1] + steps.cumsum(dim=1)], dim=1)
        off = self.asked[..., 3] - angle
        # The missing angle must not wrap from one goal to the next: all goals use the whole turns of the first.
        first = off.gather(1, where.argmax(dim=1, keepdim=True))
        off = (off - (first - wrap(first))) * where
        missing = off.sign() * (off.abs() - self.slack[..., 1]).clamp(min=0)
        sway = _unhurried(off - missing, where != 0, SWAY_RAD_S / fps)
        return off - torch.maximum(torch.minimum(sway, self.slack[..., 1]), -self.slack[..., 1])


def _product(matrices: Tensor, vectors: Tensor) -> Tensor:
    """(B, T, T) times (B, T) -> (B, T), summed row by row: a matrix product sums in another order if B is 1."""
    return (matrices * vectors[:, None]).sum(dim=-1)


def _unhurried(values: Tensor, known: Tensor, most: float) -> Tensor:
    """Values (B, T) that agree with the given ones at known frames (B, T) but change by at most `most` a frame.

    Values that already do so are unchanged. The result is the mean of the highest such curve below them and the lowest
    above.
    """
    frames = torch.arange(values.shape[1], dtype=values.dtype, device=values.device)
    apart = most * (frames[:, None] - frames).abs()
    below = (values.masked_fill(~known, torch.inf)[:, None] + apart).amin(dim=-1)
    above = (values.masked_fill(~known, -torch.inf)[:, None] - apart).amax(dim=-1)
    return torch.where(known, (below + above) / 2, 0.0)


def wrap(angle: Tensor) -> Tensor:
    """Angles in -pi..pi."""
    return angle_of(angle.sin(), angle.cos())


def make_projection(
    layout: Representation,
    observed: Tensor,
    mask: Tensor,
    planned: Tensor | None,
    *,
    first: int,
    num_frames: int,
    options: SamplingOptions,
    before: Tensor,
) -> RootProjection | None:
    """The projection of horizons that begin at frame `first` of windows; None if there is nothing to project.

    observed, mask: (B, T, D), normalised, in the windows' own frames. planned: (B, T, 2) bool, whose ground position,
    or heading, may be missed by the slack; None: no frames. before: (B, 4), from `slowing.motion_before`.
    """
    horizon = slice(first, first + num_frames)
    held = mask[:, horizon, :ROOT_WIDTH] != 0
    if not bool(held.any()):
        return free_projection(before, first, num_frames, options)
    natural = layout.root_stats.denormalize(observed[:, horizon, :ROOT_WIDTH])
    where = held[..., [0, 1, 3]]
    known = where.cpu().numpy()
    angle = np.where(known[..., 2], angle_of(natural[..., 4], natural[..., 3]).cpu().numpy(), 0.0)
    for row, frames in zip(angle, known[..., 2], strict=True):
        row[frames] = np.unwrap(row[frames])
    curves = [
        torch.from_numpy(np.stack([goal_curves(tuple(np.flatnonzero(row).tolist()), num_frames) for row in kind]))
        for kind in (known[..., 0], known[..., 1], known[..., 2])
    ]
    slack = torch.zeros_like(natural[..., :2])
    if planned is not None:
        allowed = slack.new_tensor([options.projection.slack_m, options.projection.slack_rad])
        exact = where[..., [0, 2]] & ~planned[:, horizon]
        slack = _room(exact, options.projection.settle_frames).to(slack) * planned[:, horizon] * allowed
    most = torch.full_like(natural[..., 0], _NEVER_M)
    if not options.plan_root:  # a goal that the root cannot reach in time is missed, not jumped to
        seconds = torch.arange(1, num_frames + 1, dtype=most.dtype, device=most.device) / layout.fps
        most = torch.minimum(options.projection.acceleration_m_s2 * seconds**2 / 6, seconds / 1.5).expand_as(most)
    asked = torch.stack(
        [natural[..., 0], natural[..., 2], natural[..., 1], torch.from_numpy(angle).to(natural)], dim=-1
    )
    before = torch.where(held[..., 0].any(dim=1, keepdim=True), 0.0, before)
    return RootProjection(
        first,
        *(curve.to(natural) for curve in curves),
        asked,
        where.to(natural.dtype),
        slack,
        most,
        before,
        options.projection.slowing_s,
    )


def _room(exact: Tensor, settle_frames: int) -> Tensor:
    """The share (B, T, 2) of its slack that each frame has: 0 at a goal (B, T, 2) that was asked for, rising to 1 at
    settle_frames from it. A root that used its full slack until the frame before would be jerked onto the goal.
    """
    frames = torch.arange(exact.shape[1], device=exact.device)
    away = (frames[:, None] - frames).abs().float()[None, :, :, None]  # from frame (dimension 1) to goal (dimension 2)
    nearest = torch.where(exact[:, None], away, float(settle_frames)).amin(dim=2)
    return (nearest / settle_frames).clamp(max=1)


def free_projection(
    before: Tensor, first: int, num_frames: int, options: SamplingOptions, *, skips_still: bool = True
) -> RootProjection | None:
    """The projection of rows without goals, which only slows them down; None if nothing is projected.

    before: (B, 4), from `slowing.motion_before`; rows that do not move are unchanged. skips_still: return None also if
    no row moves, which synchronises with the device.
    """
    if not options.project_root or not options.projection.slowing_s:
        return None
    if skips_still and not bool(before[:, 2:].any()):
        return None
    square = before.new_zeros(len(before), num_frames, num_frames)
    wide = [before.new_zeros(len(before), num_frames, width) for width in (4, 3, 2)]
    most = before.new_zeros(len(before), num_frames)
    return RootProjection(first, square, square, square, *wide, most, before, options.projection.slowing_s)
