"""Conditions: a session's prompts, constraints and velocity, and which of them apply to a frame."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from motiongen_server.engine.locomotion import gait_prompt
from motiongen_server.engine.session.velocity import Velocity
from motiongen_server.engine.types import Constraint, Gait, Prompt


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """What steers a session. Both tuples are in the order in which their items were set.

    gait: the source of the prompt for frames that the velocity leads; None: the session's own prompts apply.
    """

    prompts: tuple[Prompt, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    velocity: Velocity | None = None
    gait: Gait | None = None

    def gait_at(self, frame: int) -> Gait | None:
        """The gait in force at a frame. A velocity that leads no frame yet is assumed to begin there."""
        ends = self.velocity is None or self.velocity.end_if_from(frame) <= frame
        return None if ends else self.gait

    def prompt_at(self, frame: int) -> Prompt | None:
        """The prompt in force at a frame: that of a velocity that leads there, else the session's own.

        Of its own prompts that cover the frame, it is the one that starts last, then the one set last.
        """
        gait = self.gait_at(frame)
        return self._own_prompt_at(frame) if gait is None else gait_prompt(gait)

    def _own_prompt_at(self, frame: int) -> Prompt | None:
        best: Prompt | None = None
        for prompt in self.prompts:
            covers = prompt.begin <= frame and (prompt.end_frame is None or frame < prompt.end_frame)
            if covers and (best is None or prompt.begin >= best.begin):
                best = prompt
        return best

    def prompt_change_after(self, frame: int, end: int) -> int:
        """The first frame after `frame`, and before `end`, whose prompt differs from that at `frame`; else `end`.

        The end of a velocity counts from half way to `end` on at the earliest: a client that renews its velocity many
        times per second would otherwise get a few frames at a time.
        """
        from_here = self.led_from(frame)
        held = from_here.prompt_at(frame)
        half_way = (frame + end) // 2
        led_to = from_here._led_to(frame)
        frames = {max(each, half_way) if each == led_to else each for each in from_here._boundaries(frame)}
        for candidate in sorted(frames):
            if frame < candidate < end and not _same(held, from_here.prompt_at(candidate)):
                return candidate
        return end

    def led_from(self, frame: int) -> Conditions:
        """The same conditions, with the velocity leading from `frame` on if it leads no frame yet."""
        velocity = self.velocity
        if velocity is None or velocity.steers_from is not None:
            return self
        return replace(self, velocity=replace(velocity, steers_from=frame))

    def first_change(self, before: Conditions, floor: int, changed_at: int | None) -> int | None:
        """The first frame from floor on whose prompt differs from before, or changed_at, where the lead differs.

        Of both the earlier, None if there is neither. A velocity that leads no frame yet is assumed, before and after,
        to begin at floor.
        """
        before, after = before.led_from(floor), self.led_from(floor)
        for frame in sorted({floor, *before._boundaries(floor), *after._boundaries(floor)}):
            if changed_at is not None and frame >= changed_at:
                return changed_at
            if frame >= floor and not _same(before.prompt_at(frame), after.prompt_at(frame)):
                return frame
        return changed_at

    def _boundaries(self, frame: int) -> list[int]:
        """The frames at which the prompt may change, in order. frame: where a velocity that leads none yet begins."""
        led_to = self._led_to(frame)
        return sorted({*_boundaries(self.prompts), *(() if led_to is None else (led_to,))})

    def _led_to(self, frame: int) -> int | None:
        """Where a velocity with a gait ends; None without one. frame: as for `_boundaries`."""
        return None if self.velocity is None or self.gait is None else self.velocity.end_if_from(frame)

    def constraints_within(self, begin: int, end: int) -> tuple[Constraint, ...]:
        """The constraints with a frame in begin <= frame < end."""
        return tuple(item for item in self.constraints if item.last_frame >= begin and item.first_frame < end)

    def ends_within(self, begin: int, end: int) -> bool:
        """Whether the last frame of a constraint is one of begin <= frame < end."""
        return any(begin <= item.last_frame < end for item in self.constraints)

    def without_told(self, told: Collection[Constraint]) -> Conditions:
        """Remove constraints that have been answered before their last frame, as they were met at an earlier one."""
        gone = {id(item) for item in told}
        left = tuple(item for item in self.constraints if id(item) not in gone)
        return self if len(left) == len(self.constraints) else replace(self, constraints=left)

    def with_velocity_landed(self, obeyed: Velocity | None, frame: int) -> Conditions:
        """A window from `frame` on that obeys a velocity has landed; the newest begins there if it asks for the same.

        The newest may be another event's: a client that holds a stick repeats its velocity before a window can land.
        """
        held = self.velocity
        if obeyed is None or held is None or held.steers_from is not None or not held.leads_as(obeyed):
            return self
        return replace(self, velocity=held.landed(frame))

    def without_past(self, frame: int) -> Conditions:
        """Remove what ends before `frame`."""
        prompts = tuple(item for item in self.prompts if item.end_frame is None or item.end_frame > frame)
        constraints = tuple(item for item in self.constraints if item.last_frame >= frame)
        velocity = self.velocity
        if velocity is not None and velocity.end_if_from(frame) + velocity.slowing_frames <= frame:
            velocity = None
        unchanged = len(prompts) == len(self.prompts) and len(constraints) == len(self.constraints)
        if unchanged and velocity is self.velocity:
            return self
        return Conditions(prompts, constraints, velocity, None if velocity is None else self.gait)


def _boundaries(prompts: Iterable[Prompt]) -> list[int]:
    frames = {prompt.begin for prompt in prompts}
    return sorted(frames | {prompt.end_frame for prompt in prompts if prompt.end_frame is not None})


def _same(one: Prompt | None, other: Prompt | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.embedding is other.embedding or np.array_equal(one.embedding, other.embedding)
