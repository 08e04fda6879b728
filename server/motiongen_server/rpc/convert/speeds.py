"""Compares the speeds that velocities and paths ask for with those up to which a model's characters step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from motiongen_server.engine.types import Asked, Direction, RootPath, RootTrajectory, SetVelocity, Unplaced
from motiongen_server.rpc.catalog import Catalog

_OVER_S = 0.5
"""A trajectory's speed is measured over two steps of a walk: within these, roots sway, and are faster for a frame."""
_SLACK = 1.01
"""For the rounding in trajectories, and for sticks, whose range is not quite a circle."""


def speeds_of(item: Asked | RootPath | SetVelocity, fps: int) -> Mapping[Direction, float]:
    """The greatest speed, m/s, that an item asks for in each direction, relative to the heading that it asks for.

    Forward if it asks for no heading. Empty for a target place: its speed depends on where the character is then.
    """
    match item:
        case SetVelocity():
            angle = 0.0 if item.heading is None else math.atan2(item.x, item.z) - item.heading
            return {Direction(int(_quarter(angle))): math.hypot(item.x, item.z)}
        case RootPath():
            return {Direction.FORWARD: item.speed_mps}
        case Unplaced():
            return speeds_of(item.target, fps)
        case RootTrajectory():
            return _of_trajectory(item, max(1, round(_OVER_S * fps)), fps)
    return {}


def too_fast_for(item: Asked | SetVelocity, catalog: Catalog) -> Direction | None:
    """The direction in which an item exceeds the speeds of the model's gaits most; None if it does not."""
    if not catalog.abilities.gaits:
        return None
    fastest = catalog.abilities.fastest_mps
    over = {way: speed - _SLACK * fastest(way) for way, speed in speeds_of(item, catalog.facts.fps).items()}
    return max((way for way in over if over[way] > 0.0), key=over.__getitem__, default=None)


def _of_trajectory(item: RootTrajectory, apart: int, fps: int) -> Mapping[Direction, float]:
    way = item.xz[apart:].astype(np.float64) - item.xz[:-apart]
    if not len(way):
        return {}
    speed = np.hypot(way[:, 0], way[:, 1]) * (fps / apart)
    if item.heading is None:
        return {Direction.FORWARD: float(speed.max())}
    quarter = _quarter(np.arctan2(way[:, 0], way[:, 1]) - item.heading[apart // 2 :][: len(way)])
    return {each: float(speed[quarter == each].max()) for each in Direction if (quarter == each).any()}


def _quarter(angle: Any) -> Any:
    """The direction, as a number, whose quarter turn has the angle: radians to the left of where a character faces."""
    return np.rint(angle / (math.pi / 2)) % len(Direction)
