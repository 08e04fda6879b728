"""Velocity: a speed and direction that steers a character for a while, as a root trajectory in each window."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from motiongen_ardy.locomotion.velocity import RootState, lead_by, slowing_frames
from motiongen_server.engine.types import VELOCITY_ID, RootTrajectory, SetVelocity


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity in force. steers_from: the first frame that it steers, None until a window that obeys it has landed.

    x, z: metres per second in the world. heading: radians, None for any. It ends hold_frames after steers_from.
    asked_from: the first frame that could still change when it was asked for, before which it never steers.
    """

    x: float
    z: float
    heading: float | None
    hold_frames: int
    steers_from: int | None = None
    asked_from: int = 0

    def landed(self, frame: int) -> Velocity:
        """The velocity after a window from `frame` on has landed that obeys it, or one that asks for the same."""
        return replace(self, steers_from=max(frame, self.asked_from))

    def end_if_from(self, frame: int) -> int:
        """The first frame that it no longer steers. frame: where it starts if that is not known yet."""
        return (frame if self.steers_from is None else self.steers_from) + self.hold_frames

    def leads_as(self, other: Velocity) -> bool:
        """Whether it asks for the same motion, for any duration."""
        return (self.x, self.z, self.heading) == (other.x, other.z, other.heading)

    @property
    def slowing_frames(self) -> int:
        """Frames after its end during which it still leads, until the character stands."""
        return slowing_frames(self.x, self.z)

    def path(self, begin: int, end: int, root: RootState, fps: int) -> RootTrajectory | None:
        """The trajectory for begin <= frame < end, starting where the root is; None if the velocity has run out."""
        held = self.end_if_from(begin) - begin
        lead = lead_by((self.x, self.z), self.heading, held, end - begin, root, fps)
        if lead is None:
            return None
        heading = None if lead.heading is None else lead.heading.astype(np.float32)
        return RootTrajectory(VELOCITY_ID, begin, lead.ground.astype(np.float32), heading)


class Steered(NamedTuple):
    """A velocity after an event. dirty_from: the first frame that the event changes, None for none.

    prolongs: the event only repeats the velocity in force, which thus ends later.
    """

    velocity: Velocity
    dirty_from: int | None
    prolongs: bool = False


def changed_velocity(held: Velocity | None, event: SetVelocity, floor: int) -> Steered:
    """The velocity after an event. floor: the first frame that can still change."""
    asked = Velocity(event.x, event.z, event.heading, event.hold_frames, asked_from=floor)
    if held is None or held.steers_from is None:
        return Steered(asked, floor)
    old_end = held.end_if_from(floor)
    if old_end <= floor or not held.leads_as(asked):
        return Steered(asked, floor)
    again = Velocity(event.x, event.z, event.heading, event.hold_frames, steers_from=floor)
    new_end = again.end_if_from(floor)
    return Steered(again, None if new_end == old_end else min(old_end, new_end), prolongs=new_end > old_end)
