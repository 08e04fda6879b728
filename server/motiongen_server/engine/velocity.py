"""Velocity: a speed and direction that steers a character for a while, as a root trajectory inside each window."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.types import Float32Array, RootPath, SetVelocity

# Numbers that clients choose start at 1, so this one can name no constraint of theirs.
VELOCITY_ID = 0
# Nobody gets from one speed to another at once: the trajectory changes over from what the root does to what is asked.
_CHANGE_S = 0.3


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

    def path(self, begin: int, end: int, root: RootState, fps: int) -> RootPath | None:
        """The trajectory of frames begin <= frame < end, on from where the root is; None where it has run out.

        Every window starts from where the character is, not from where it should be: one that fell behind walks on at
        the speed asked for rather than catch up in a spurt.
        """
        count = min(end, self.end_if_from(begin)) - begin
        if count <= 0:
            return None
        change = np.minimum(np.arange(1, count + 1) / (_CHANGE_S * fps), 1.0)
        xz = np.stack(
            (_travel(root.x, root.speed_x, self.x, change, fps), _travel(root.z, root.speed_z, self.z, change, fps)),
            axis=1,
        )
        heading = None
        if self.heading is not None:
            turn = math.remainder(self.heading - root.heading, math.tau)
            heading = (root.heading + turn * change).astype(np.float32)
        return RootPath(VELOCITY_ID, begin, xz.astype(np.float32), heading)


def _travel(start: float, before: float, after: float, change: np.ndarray, fps: int) -> np.ndarray:
    return start + np.cumsum(before + (after - before) * change) / fps


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
    """What the root does at the end of some frames. positions: (T, 3) metres, T at least 1."""
    last = positions[-1]
    speed = (last - positions[-2]) * fps if len(positions) > 1 else np.zeros(3)
    return RootState(float(last[0]), float(last[2]), float(speed[0]), float(speed[2]), heading)
