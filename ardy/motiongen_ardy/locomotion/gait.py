"""Chooses the gait (the prompt) for a velocity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, TypeVar

# Hysteresis: a stick held at the border between two gaits must not cause many replans a second.
SPEED_MARGIN = 0.1  # of the speed
ANGLE_MARGIN_RAD = math.radians(10)
FORWARD = 0


class Gait(Protocol):
    """A prompt for moving at from_mps metres a second or more in a quarter: 0 forward, 1 left, 2 backward, 3 right."""

    @property
    def from_mps(self) -> float: ...

    @property
    def quarter(self) -> int: ...


G = TypeVar("G", bound=Gait)


def gait_of(gaits: Sequence[G], x: float, z: float, heading: float | None, held: G | None) -> G | None:
    """The gait for a velocity x, z in metres a second; None if no gait fits.

    heading: radians; None: the character faces where it goes. held: the gait in force so far, which is kept while the
    new velocity is within the margins of its range.
    """
    if not gaits:
        return None
    speed = math.hypot(x, z)
    angle = 0.0 if heading is None else math.remainder(math.atan2(x, z) - heading, math.tau)
    speeds = (speed, speed * (1 - SPEED_MARGIN), speed * (1 + SPEED_MARGIN))
    angles = (angle, angle - ANGLE_MARGIN_RAD, angle + ANGLE_MARGIN_RAD)
    near = [gait_at(gaits, each, quarter_of(turn)) for each in speeds for turn in angles]
    return held if any(gait is held for gait in near) else near[0]


def quarter_of(angle: float) -> int:
    """The quarter of an angle in radians from a character's facing; positive angles are to its left."""
    return round(angle / (math.pi / 2)) % 4


def gait_at(gaits: Sequence[G], speed: float, quarter: int) -> G | None:
    """The fastest gait in a quarter whose from_mps `speed` reaches; if that quarter has none, of those forward."""
    reached = [gait for gait in gaits if gait.from_mps <= speed]
    own = [gait for gait in reached if gait.quarter == quarter]
    forward = [gait for gait in reached if gait.quarter == FORWARD]
    return max(own or forward, key=lambda gait: gait.from_mps, default=None)
