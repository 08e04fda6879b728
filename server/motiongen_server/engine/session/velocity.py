"""Velocity: a speed and direction that steers a character for a while, as a root trajectory inside each window."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.types import VELOCITY_ID, Float32Array, RootTrajectory, SetVelocity

# Nobody gets from one speed to another, or round, at once: as people do it, and never in less than _SHORTEST_S.
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


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity in force. steers_from: the first frame that it steers, None until a window that obeys it has landed.

    x, z: metres a second in the world. heading: radians, None for any. It ends hold_frames after steers_from.
    """

    x: float
    z: float
    heading: float | None
    hold_frames: int
    steers_from: int | None = None

    def end_if_from(self, frame: int) -> int:
        """The first frame that it no longer steers, if it first steers `frame` where that is not known yet."""
        return (frame if self.steers_from is None else self.steers_from) + self.hold_frames

    @property
    def slowing_frames(self) -> int:
        """Frames after its end that it still leads, to a stand."""
        return SLOWING_FRAMES if math.hypot(self.x, self.z) > 0.0 else 0

    def path(self, begin: int, end: int, root: RootState, fps: int) -> RootTrajectory | None:
        """The trajectory of frames begin <= frame < end, on from where the root is; None where it has run out.

        Every window starts from where the character is, not from where it should be: one that fell behind walks on at
        the speed asked for rather than catch up in a spurt. Where no heading is asked for, who walks turns to where it
        goes, and walks there once it has turned half round.
        """
        held = self.end_if_from(begin) - begin
        count = min(end - begin, held + self.slowing_frames)
        if count <= 0:
            return None
        before, after = np.array([root.speed_x, root.speed_z]), np.array([self.x, self.z])
        facing = self.heading
        if facing is None and math.hypot(self.x, self.z) > _WALK_M_S:
            facing = math.atan2(self.x, self.z)
        turn = 0.0 if facing is None else math.remainder(facing - root.heading, math.tau)
        change_s = max(_SHORTEST_S, float(np.hypot(*(after - before))) / _ACCELERATION_M_S2)
        turn_s = max(_SHORTEST_S, abs(turn) / _TURN_RAD_S)
        wait_s, turn_wait_s = 0.0, 0.0
        if self.heading is None and abs(turn) > math.pi / 2:
            wait_s = turn_s / 2 - change_s * _still_at(before, after)
            wait_s, turn_wait_s = max(0.0, wait_s), max(0.0, -wait_s)
        time = np.arange(1, count + 1) / fps
        speed = before + np.clip((time - wait_s) / change_s, 0.0, 1.0)[:, None] * (after - before)
        if count > max(0, held):
            _slow_down(speed, max(0, held), held + self.slowing_frames, before)
        xz = np.array([root.x, root.z]) + np.cumsum(speed, axis=0) / fps
        heading = None
        if facing is not None:
            share = np.clip((time - turn_wait_s) / turn_s, 0.0, 1.0)
            heading = (root.heading + turn * share).astype(np.float32)
        return RootTrajectory(VELOCITY_ID, begin, xz.astype(np.float32), heading)


def _still_at(before: np.ndarray, after: np.ndarray) -> float:
    """At which share of the change from one velocity (2) to another nothing moves along the second any more."""
    change = after - before
    return float(np.clip(-before @ change / max(float(change @ change), 1e-9), 0.0, 1.0))


def _slow_down(speed: np.ndarray, held: int, still: int, before: np.ndarray) -> None:
    """Bring speeds (T, 2) from frame `held` on to a stand at frame `still`; before: of frame -1."""
    last = speed[held - 1].copy() if held else before
    left = still - held
    frames = np.arange(1, len(speed) - held + 1)
    speed[held:] = last * np.clip(1.0 - frames / left, 0.0, 1.0)[:, None]


def changed_velocity(held: Velocity | None, event: SetVelocity, floor: int) -> tuple[Velocity, int | None]:
    """The velocity after an event. floor: the first frame that can still change.

    Returns it and the first frame that it changes: floor, or None or where the old one would have ended, if the event
    only says again what holds.
    """
    asked = Velocity(event.x, event.z, event.heading, event.hold_frames)
    if held is None or held.steers_from is None:
        return asked, floor
    old_end = held.end_if_from(floor)
    if old_end <= floor or (held.x, held.z, held.heading) != (asked.x, asked.z, asked.heading):
        return asked, floor
    again = Velocity(event.x, event.z, event.heading, event.hold_frames, steers_from=floor)
    new_end = again.end_if_from(floor)
    return again, None if new_end == old_end else min(old_end, new_end)


def root_state(positions: Float32Array, heading: float, fps: int) -> RootState:
    """What the root does at the end of some frames. positions: (T, 3) metres, T at least 1; the last few tell."""
    recent = positions[-STATE_FRAMES:]
    last = recent[-1]
    speed = (last - recent[0]) * (fps / max(1, len(recent) - 1))
    return RootState(float(last[0]), float(last[2]), float(speed[0]), float(speed[2]), heading)
