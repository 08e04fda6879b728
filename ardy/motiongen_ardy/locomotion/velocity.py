"""Where a velocity leads the root: speed and heading change gradually from what they are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Typical of people; no change takes less than _SHORTEST_S.
_ACCELERATION_M_S2 = 2.2
_TURN_RAD_S = 2.6
_SHORTEST_S = 0.3
# Below this speed nobody turns to walk: without a heading asked for, any will do.
_WALK_M_S = 0.3
STATE_FRAMES = 4
"""Frames from which a root's speed is measured: fewer would show the sway of a step."""
SLOWING_FRAMES = 16
"""Frames after the end of a velocity within which the character slows to a stand."""


@dataclass(frozen=True, slots=True)
class RootState:
    """Position, velocity and heading of the root just before a window: metres, metres a second, radians."""

    x: float
    z: float
    speed_x: float
    speed_z: float
    heading: float


class Lead(NamedTuple):
    """The root at consecutive frames. ground: (K, 2), x and z in metres; heading: (K) radians; None: any heading."""

    ground: NDArray[np.float64]
    heading: NDArray[np.float64] | None


def root_state(ground: NDArray[Any], heading: float, fps: int) -> RootState:
    """The root's state at the last frame. ground: (T, 2) metres, T at least 1; the last STATE_FRAMES give the speed."""
    recent = ground[-STATE_FRAMES:]
    last = recent[-1]
    speed = (last - recent[0]) * (fps / max(1, len(recent) - 1))
    return RootState(float(last[0]), float(last[1]), float(speed[0]), float(speed[1]), heading)


def slowing_frames(x: float, z: float) -> int:
    """For how many frames after the end of a velocity the character slows to a stand."""
    return SLOWING_FRAMES if math.hypot(x, z) > 0.0 else 0


def lead_by(
    asked: tuple[float, float], heading: float | None, held: int, most: int, root: RootState, fps: int
) -> Lead | None:
    """Where a velocity leads in the `most` frames after `root`; None if it has ended and the character stands.

    asked: x and z, metres a second in the world; heading: radians; None: any. held: for how many of the frames the
    velocity is still in force; negative if it ended before them. The result starts from where the character is, not
    from where it should be: one that fell behind continues at the speed asked for instead of catching up in a spurt.
    Without a heading, a walking character turns to face where it goes; a turn of more than 90 degrees comes first, and
    it sets off when half of that turn is done.
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
    """At which share of the change from one velocity (2) to another the component along the change is zero."""
    change = after - before
    return float(np.clip(-before @ change / max(float(change @ change), 1e-9), 0.0, 1.0))


def _slow_down(speed: NDArray[np.float64], held: int, still: int, before: NDArray[np.float64]) -> None:
    """Slow speeds (T, 2) from frame `held` on down to zero at frame `still`; before: the speed at frame -1."""
    last = speed[held - 1].copy() if held else before
    left = still - held
    frames = np.arange(1, len(speed) - held + 1)
    speed[held:] = last * np.clip(1.0 - frames / left, 0.0, 1.0)[:, None]
