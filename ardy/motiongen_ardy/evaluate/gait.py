"""The prompt of a velocity: which of the model's gaits holds, as the server chooses it; a parity test compares them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from motiongen_ardy.capabilities import DIRECTIONS, LocomotionPreset
from motiongen_ardy.evaluate.take import Steer

_SPEED_MARGIN = 0.1
_ANGLE_MARGIN = math.radians(10)


def gait_of(
    gaits: Sequence[LocomotionPreset], steer: Steer, held: LocomotionPreset | None = None
) -> LocomotionPreset | None:
    """The gait for a velocity; None where the model has none, or the take keeps its prompt. held: the one before."""
    if steer.keep_prompt or not gaits:
        return None
    speed = math.hypot(steer.x, steer.z)
    angle = 0.0
    if steer.heading is not None:
        angle = math.remainder(math.atan2(steer.x, steer.z) - steer.heading, math.tau)
    near = [
        _gait_at(gaits, each, DIRECTIONS[round(turn / (math.pi / 2)) % 4])
        for each in (speed, speed * (1 - _SPEED_MARGIN), speed * (1 + _SPEED_MARGIN))
        for turn in (angle, angle - _ANGLE_MARGIN, angle + _ANGLE_MARGIN)
    ]
    return held if held is not None and held in near else near[0]


def _gait_at(gaits: Sequence[LocomotionPreset], speed: float, direction: str) -> LocomotionPreset | None:
    reached = [gait for gait in gaits if gait.from_mps <= speed]
    own = [gait for gait in reached if gait.direction == direction]
    forward = [gait for gait in reached if gait.direction == "forward"]
    return max(own or forward, key=lambda gait: gait.from_mps, default=None)
