"""Retarget: which source joint drives which joint of our skeleton, as validated data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from motiongen_ardy.core.skeleton import Skeleton


class RetargetError(ValueError):
    """Raised for a retarget file that cannot be used. The message names the file, the place and what is allowed."""


@dataclass(frozen=True)
class JointRule:
    """A target joint that takes the global rotation of `source`, whose own axes in the neutral pose are `axes`.

    turn: an optional further rotation of those axes, (direction, degrees or the name of a value).
    """

    source: str
    axes: tuple[str, str, str]
    turn: tuple[str, float | str] | None


@dataclass(frozen=True)
class FillRule:
    """A target joint without a source: its global rotation is interpolated at `fraction` between two others."""

    start: str
    end: str
    fraction: float


@dataclass(frozen=True)
class LegScale:
    """The scale is the mean length of the `target` chains divided by that of the `source` chains."""

    source: tuple[tuple[str, ...], ...]
    target: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class FixedGround:
    """The source height (a number or the name of a value) is mapped to `height_m`."""

    source_height: float | str
    height_m: float


@dataclass(frozen=True)
class MeasuredGround:
    """One shift per clip, which puts a percentile over frames of the lowest of `joints` at `height_m`."""

    joints: tuple[str, ...]
    percentile: float
    height_m: float


@dataclass(frozen=True)
class Retarget:
    """A validated retarget description. identity: target joints that keep the identity relative to their parent.

    The midpoint of the `root_target` joints is placed at the scaled midpoint of the `root_source` joints.
    feet: pairs (source joint, target joint), to measure how well planted feet stay planted.
    """

    name: str
    skeleton: Skeleton
    metres_per_unit: float
    values: Mapping[str, float]
    groups: Mapping[str, Mapping[str, float]]
    joints: Mapping[str, JointRule]
    between: Mapping[str, FillRule]
    identity: frozenset[str]
    root_source: tuple[str, ...]
    root_target: tuple[str, ...]
    scale: float | LegScale
    ground: FixedGround | MeasuredGround
    feet: tuple[tuple[str, str], ...]

    @property
    def source_joints(self) -> frozenset[str]:
        """Every source joint that a clip must have."""
        names = {rule.source for rule in self.joints.values()} | set(self.root_source)
        if isinstance(self.scale, LegScale):
            names.update(name for chain in self.scale.source for name in chain)
        return frozenset(names | {source for source, _ in self.feet})

    def values_for(self, group: str) -> dict[str, float]:
        """The named values for a rest group; the defaults for "" and for groups without a section."""
        return {**self.values, **self.groups.get(group, {})}
