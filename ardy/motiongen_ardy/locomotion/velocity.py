"""Where a velocity leads the root from where it is: nobody gets from one speed to another, or round, at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# As people do it, and never in less than _SHORTEST_S.
_ACCELERATION_M_S2 = 2.2
_TURN_RAD_S = 2.6
_SHORTEST_S = 0.3
# Slower than this nobody turns to walk: whoever is asked for less may look anywhere.
_WALK_M_S = 0.3
STATE_FRAMES = 4
"""Frames that a root's speed is read from: fewer show the sway of a step."""
SLOWING_FRAMES = 16
"""Frames after its end over which a velocity is slowed to a stand."""


@dataclass(frozen=True, slots=True)
class RootState:
    """What the root does just before a window: metres, metres a second, radians."""

    x: float
    z: float
    speed_x: float
    speed_z: float
    heading: float


class Lead(NamedTuple):
    """The root of frames one after another. ground: (K, 2) x and z in metres; heading: (K) radians, None for any."""

    ground: NDArray[np.float64]
    heading: NDArray[np.float64] | None


def root_state(ground: NDArray[Any], heading: float, fps: int) -> RootState:
    """What the root does at the end of some frames. ground: (T, 2) metres, T at least 1; the last few tell."""
    recent = ground[-STATE_FRAMES:]
    last = recent[-1]
    speed = (last - recent[0]) * (fps / max(1, len(recent) - 1))
    return RootState(float(last[0]), float(last[1]), float(speed[0]), float(speed[1]), heading)


def slowing_frames(x: float, z: float) -> int:
    """Frames after the end of a velocity that it still leads, to a stand."""
    return SLOWING_FRAMES if math.hypot(x, z) > 0.0 else 0


def lead_by(
    asked: tuple[float, float], heading: float | None, held: int, most: int, root: RootState, fps: int
) -> Lead | None:
    """Where a velocity leads in the `most` frames after those that `root` tells of; None where it has run out.

    asked: x and z, metres a second in the world; heading: radians, None for any. held: of the frames, how many it
    still holds, below 0 where it ended before. It starts from where the character is, not from where it should be: one
    that fell behind walks on at the speed asked for rather than catch up in a spurt. Where no heading is asked for,
    who walks turns to where it goes, and walks there once it has turned half round.
    """
    slowing = slowing_frames(*asked)
    count = min(most, held + slowing)
    if count <= 0:
        return None
    before, after = np.array([root.speed_x, root.speed_z]), np.array(asked)
    facing = heading
    if facing is None and math.hypot(*asked) > _WALK_M_S:
        facing = math.atan2(*asked)
    turn = 0.0 if facing is None else math.remainder(facing - root.heading, math.tau)
    change_s = max(_SHORTEST_S, float(np.hypot(*(after - before))) / _ACCELERATION_M_S2)
    turn_s = max(_SHORTEST_S, abs(turn) / _TURN_RAD_S)
    wait_s, turn_wait_s = 0.0, 0.0
    if heading is None and abs(turn) > math.pi / 2:
        wait_s = turn_s / 2 - change_s * _still_at(before, after)
        wait_s, turn_wait_s = max(0.0, wait_s), max(0.0, -wait_s)
    time = np.arange(1, count + 1) / fps
    speed = before + np.clip((time - wait_s) / change_s, 0.0, 1.0)[:, None] * (after - before)
    if count > max(0, held):
        _slow_down(speed, max(0, held), held + slowing, before)
    ground = np.array([root.x, root.z]) + np.cumsum(speed, axis=0) / fps
    if facing is None:
        return Lead(ground, None)
    return Lead(ground, root.heading + turn * np.clip((time - turn_wait_s) / turn_s, 0.0, 1.0))


def _still_at(before: NDArray[np.float64], after: NDArray[np.float64]) -> float:
    """At which share of the change from one velocity (2) to another nothing moves along the second any more."""
    change = after - before
    return float(np.clip(-before @ change / max(float(change @ change), 1e-9), 0.0, 1.0))


def _slow_down(speed: NDArray[np.float64], held: int, still: int, before: NDArray[np.float64]) -> None:
    """Bring speeds (T, 2) from frame `held` on to a stand at frame `still`; before: of frame -1."""
    last = speed[held - 1].copy() if held else before
    left = still - held
    frames = np.arange(1, len(speed) - held + 1)
    speed[held:] = last * np.clip(1.0 - frames / left, 0.0, 1.0)[:, None]
