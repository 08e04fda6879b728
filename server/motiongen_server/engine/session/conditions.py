"""Conditions: the prompts and constraints of a session, and what an edit of them changes from which frame on."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motiongen_server.engine.locomotion import gait_prompt
from motiongen_server.engine.session.placing import Anchor, placed
from motiongen_server.engine.session.velocity import Velocity
from motiongen_server.engine.types import (
    Asked,
    Code,
    Constraint,
    EventRefused,
    Gait,
    Placement,
    Prompt,
    RootTrajectory,
    SetConstraints,
    SetPrompts,
    Unplaced,
)


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """What steers a session. Both tuples are in the order in which their items were set.

    gait: whose prompt holds at the frames that the velocity leads; None: the session's own do.
    """

    prompts: tuple[Prompt, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    velocity: Velocity | None = None
    gait: Gait | None = None

    def gait_at(self, frame: int) -> Gait | None:
        """The gait that holds at a frame. A velocity that leads no frame yet is taken to begin there."""
        ends = self.velocity is None or self.velocity.end_if_from(frame) <= frame
        return None if ends else self.gait

    def prompt_at(self, frame: int) -> Prompt | None:
        """The prompt that holds at a frame: that of a velocity that leads there, else the session's own.

        Of its own that cover the frame it is the one that starts last, then the one set last.
        """
        gait = self.gait_at(frame)
        return self._own_prompt_at(frame) if gait is None else gait_prompt(gait)

    def _own_prompt_at(self, frame: int) -> Prompt | None:
        best: Prompt | None = None
        for prompt in self.prompts:
            covers = _start(prompt) <= frame and (prompt.end_frame is None or frame < prompt.end_frame)
            if covers and (best is None or _start(prompt) >= _start(best)):
                best = prompt
        return best

    def prompt_change_after(self, frame: int, end: int) -> int:
        """The first frame after `frame` whose prompt is another one than at `frame`; `end` if there is none before.

        A velocity that ends soon counts from half way to `end` on: one that is renewed many times a second would else
        leave a client with a few frames at a time.
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
        """The same with a velocity that leads from a frame on, where it leads none yet."""
        velocity = self.velocity
        if velocity is None or velocity.steers_from is not None:
            return self
        return replace(self, velocity=replace(velocity, steers_from=frame))

    def first_change(self, before: Conditions, floor: int, changed_at: int | None) -> int | None:
        """The first frame from floor on that is led elsewhere, at changed_at, or has another prompt than before.

        None where neither is so. Both are taken to be led from floor on by a velocity that leads no frame yet.
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
        """Where a velocity with a gait ends; None where there is none. frame: as for `_boundaries`."""
        return None if self.velocity is None or self.gait is None else self.velocity.end_if_from(frame)

    def constraints_within(self, begin: int, end: int) -> tuple[Constraint, ...]:
        """The constraints with a frame in begin <= frame < end."""
        return tuple(item for item in self.constraints if item.last_frame >= begin and item.first_frame < end)

    def without_told(self, told: Collection[Constraint]) -> Conditions:
        """Forget constraints that have been answered before their last frame: they were met at an earlier one."""
        gone = {id(item) for item in told}
        left = tuple(item for item in self.constraints if id(item) not in gone)
        return self if len(left) == len(self.constraints) else replace(self, constraints=left)

    def with_velocity_landed(self, obeyed: Velocity | None, frame: int) -> Conditions:
        """A window from `frame` on that obeys a velocity has landed: if it is the newest, its time begins there."""
        if obeyed is None or obeyed is not self.velocity or obeyed.steers_from is not None:
            return self
        return replace(self, velocity=replace(obeyed, steers_from=frame))

    def without_past(self, frame: int) -> Conditions:
        """Forget what ends before `frame`."""
        prompts = tuple(item for item in self.prompts if item.end_frame is None or item.end_frame > frame)
        constraints = tuple(item for item in self.constraints if item.last_frame >= frame)
        velocity = self.velocity
        if velocity is not None and velocity.end_if_from(frame) + velocity.slowing_frames <= frame:
            velocity = None
        unchanged = len(prompts) == len(self.prompts) and len(constraints) == len(self.constraints)
        if unchanged and velocity is self.velocity:
            return self
        return Conditions(prompts, constraints, velocity, None if velocity is None else self.gait)


def edit_prompts(held: Conditions, event: SetPrompts, floor: int, limit: int) -> tuple[Conditions, int | None]:
    """Apply an edit of prompts. floor: the first frame that can still change.

    Returns the new conditions and the first frame from floor on whose prompt differs, None if none does. A prompt that
    holds already goes on until the one that takes its place begins: no frame between is without text, nor one before
    floor, where a window may still be made: the client, once it reports, may turn out not to be as far as was thought.
    Raises EventRefused for an unknown id, a span that has passed, or more than `limit` prompts.
    """
    # Of several with one id those before the last are what is left of those in whose place it came. What is left stays
    # where it was, since of equal starts the one set last wins.
    prompts: list[Prompt] = list(held.prompts)
    for index, prompt_id in enumerate(event.remove):
        ids = {each.prompt_id for each in prompts}
        if prompt_id not in ids:
            raise _unknown("prompt", prompt_id, index, ids)
        prompts = [each for each in prompts if each.prompt_id != prompt_id]
    for index, prompt in enumerate(event.upsert):
        if prompt.end_frame is not None and prompt.end_frame <= floor:
            raise _passed(
                "prompt", prompt.prompt_id, prompt.end_frame - 1, floor, f"edit_prompts.upsert[{index}].end_frame"
            )
        begin = max(floor, _start(prompt))
        of_its_id = [each for each in prompts if each.prompt_id == prompt.prompt_id]
        left = iter(_left_until(begin, floor, of_its_id))
        edited = [next(left) if each.prompt_id == prompt.prompt_id else each for each in prompts]
        prompts = [each for each in edited if each is not None]
        prompts.append(replace(prompt, start_frame=begin))
    if (count := len({each.prompt_id for each in prompts})) > limit:
        raise _too_many("prompts", count, limit)
    result = replace(held, prompts=tuple(prompts))
    return result, result.first_change(held, floor, None)


def _left_until(begin: int, floor: int, held: Sequence[Prompt]) -> list[Prompt | None]:
    """What is left of each of the prompts of an id, in their order, where another takes their place at `begin`."""
    left = list(held)
    never_begins = bool(held) and _start(held[-1]) > floor
    if never_begins and len(held) > 1 and held[-2].end_frame == _start(held[-1]):
        left[-2] = replace(held[-2], end_frame=begin)  # it was cut for that one
    cut: list[Prompt | None] = []
    for each in left[:-1] if never_begins else left:
        ends_later = each.end_frame is None or each.end_frame > begin
        cut.append(None if _start(each) >= begin else replace(each, end_frame=begin) if ends_later else each)
    return [*cut, None] if never_begins else cut


def edit_constraints(
    held: Conditions, event: SetConstraints, floor: int, limit: int, most_frames: int, anchor: Callable[[], Anchor]
) -> tuple[Conditions, tuple[Constraint, ...], tuple[Placement, ...]]:
    """Apply an edit of constraints. floor: the first frame that can still change; anchor: for what asks "from here".

    Returns the new conditions, every constraint that came, went or was replaced, and where those that left it open
    were put. Raises EventRefused for an unknown id, a target that has passed, more than `limit` constraints, or
    trajectories of more than most_frames together.
    """
    constraints = {item.constraint_id: item for item in held.constraints}
    changed: list[Constraint] = []
    if event.clear:
        changed.extend(constraints.values())
        constraints.clear()
    for index, constraint_id in enumerate(event.remove):
        if constraint_id not in constraints:
            raise _unknown("constraint", constraint_id, index, constraints)
        changed.append(constraints.pop(constraint_id))
    upserts, placements = place_all(event.upsert, anchor, "edit_constraints.upsert", most_frames)
    for index, item in enumerate(upserts):
        # Of several frames at which it may be met one that still can be is enough.
        latest = item.first_frame if isinstance(item, RootTrajectory) else item.last_frame
        if latest < floor:
            field = f"edit_constraints.upsert[{index}].frame"
            raise _passed("constraint", item.constraint_id, latest, floor, field)
        replaced = constraints.pop(item.constraint_id, None)
        changed.extend([item] if replaced is None else [item, replaced])
        constraints[item.constraint_id] = item
    if len(constraints) > limit:
        raise _too_many("constraints", len(constraints), limit)
    if (frames := sum(map(_trajectory_frames, constraints.values()))) > most_frames:
        raise _too_many_frames(frames, most_frames, "edit_constraints.upsert")
    return replace(held, constraints=tuple(constraints.values())), tuple(changed), placements


def place_all(
    asked: Sequence[Asked], anchor: Callable[[], Anchor], field: str, most_frames: int
) -> tuple[tuple[Constraint, ...], tuple[Placement, ...]]:
    """Constraints as they are asked for, in frames and in the world; and where those were put that left it open.

    field: the path of their list. Raises EventRefused for one that cannot be placed, and for trajectories of more than
    most_frames together, before any more of them are worked out.
    """
    constraints: list[Constraint] = []
    frames = 0
    placements: list[Placement] = []
    here: Anchor | None = None  # most edits need none, and it costs a pose
    for index, item in enumerate(asked):
        if isinstance(item, Unplaced):
            here = here or anchor()
            constraint, placement = placed(item, here, f"{field}[{index}]")
            constraints.append(constraint)
            placements.append(placement)
        else:
            constraints.append(item)
        frames += _trajectory_frames(constraints[-1])
        if frames > most_frames:
            raise _too_many_frames(frames, most_frames, f"{field}[{index}]")
    return tuple(constraints), tuple(placements)


def _trajectory_frames(constraint: Constraint) -> int:
    """That it says a place for, each of its own; other constraints take no more memory the longer they hold."""
    return len(constraint.xz) if isinstance(constraint, RootTrajectory) else 0


def _start(prompt: Prompt) -> int:
    return prompt.start_frame or 0


def _boundaries(prompts: Iterable[Prompt]) -> list[int]:
    frames = {_start(prompt) for prompt in prompts}
    return sorted(frames | {prompt.end_frame for prompt in prompts if prompt.end_frame is not None})


def _same(one: Prompt | None, other: Prompt | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.embedding is other.embedding or np.array_equal(one.embedding, other.embedding)


def _unknown(what: str, given: int, index: int, held: Iterable[int]) -> EventRefused:
    listed = ", ".join(map(str, sorted(held)[:16])) or "none"
    return EventRefused(
        Code.NOT_FOUND,
        f"UNKNOWN_{what.upper()}",
        f"{what} {given} is not set: it never was, was removed, or its frames have passed; leave it out",
        f"edit_{what}s.remove[{index}]",
        f"the ids that are set: {listed}",
    )


def _passed(what: str, given: int, frame: int, floor: int, field: str) -> EventRefused:
    return EventRefused(
        Code.FAILED_PRECONDITION,
        "FRAME_COMMITTED",
        f"{what} {given} asks for frame {frame}, but frames below {floor} cannot change any more; choose a later frame",
        field,
        f"a frame from {floor} on",
    )


def _too_many(what: str, given: int, limit: int) -> EventRefused:
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        f"TOO_MANY_{what.upper()}",
        f"the session would hold {given} {what}; remove some or reuse their ids",
        f"edit_{what}.upsert",
        f"at most {limit} {what} at once",
    )


def _too_many_frames(given: int, limit: int, field: str) -> EventRefused:
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "TOO_MANY_TRAJECTORY_FRAMES",
        f"trajectories and paths would have {given} frames together; send the later ones when earlier ones are over",
        field,
        f"at most {limit} frames at once (max_held_trajectory_frames)",
    )
