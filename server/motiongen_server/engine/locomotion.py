"""The prompt of a velocity: which of the model's gaits holds while it leads."""

from __future__ import annotations

import math
from collections.abc import Sequence

from motiongen_server.engine.types import Direction, Gait, Prompt, SetVelocity

# Gaits have no number among the prompts of clients, which start at 1.
GAIT_ID = 0
# A stick at the border between two gaits must not have the motion replanned many times a second.
SPEED_MARGIN = 0.1  # of the speed
ANGLE_MARGIN_RAD = math.radians(10)


def gait_of(gaits: Sequence[Gait], event: SetVelocity, held: Gait | None) -> Gait | None:
    """The gait for a velocity; None where there is none, or the session's own prompts shall hold.

    held: the gait of the velocity that is in force. It stays while the new one is nearer to its range than the margins.
    """
    if event.keep_prompt or not gaits:
        return None
    speed = math.hypot(event.x, event.z)
    angle = 0.0 if event.heading is None else math.remainder(math.atan2(event.x, event.z) - event.heading, math.tau)
    speeds = (speed, speed * (1 - SPEED_MARGIN), speed * (1 + SPEED_MARGIN))
    angles = (angle, angle - ANGLE_MARGIN_RAD, angle + ANGLE_MARGIN_RAD)
    near = [_gait_at(gaits, each, direction_of(turn)) for each in speeds for turn in angles]
    return held if any(gait is held for gait in near) else near[0]


def gait_prompt(gait: Gait) -> Prompt:
    """A gait as a prompt that holds whenever it is asked for."""
    return Prompt(GAIT_ID, None, None, gait.text, gait.embedding)


def direction_of(angle: float) -> Direction:
    """The direction of an angle in radians from where a character faces; positive is to its left."""
    return Direction(round(angle / (math.pi / 2)) % 4)


def _gait_at(gaits: Sequence[Gait], speed: float, direction: Direction) -> Gait | None:
    """The fastest one that a speed reaches, of the direction if there is one, else of those forward."""
    reached = [gait for gait in gaits if gait.from_mps <= speed]
    own = [gait for gait in reached if gait.direction is direction]
    forward = [gait for gait in reached if gait.direction is Direction.FORWARD]
    return max(own or forward, key=lambda gait: gait.from_mps, default=None)
