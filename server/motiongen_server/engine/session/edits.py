"""Edits: what an event changes, and the queue of edits that wait for the plan that answers them."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import NamedTuple, TypeAlias

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.locomotion import gait_of
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.constraint_edits import by_last, edit_constraints
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.session.prompt_edits import edit_prompts
from motiongen_server.engine.session.velocity import changed_velocity
from motiongen_server.engine.types import (
    Code,
    Constraint,
    Gait,
    Outcome,
    Placement,
    SessionKey,
    SetConstraints,
    SetPrompts,
    SetVelocity,
    Unplaced,
)
from motiongen_server.engine.types.refusals import too_many_pending

SEEK = "seek"
"""The kind of edit that puts the character elsewhere."""

EditEvent: TypeAlias = SetPrompts | SetConstraints | SetVelocity


@dataclass(frozen=True, slots=True)
class PendingEdit:
    """An edit that waits for the plan that answers it. dirty_from: the first frame it changes.

    left_open: its constraints that left their placing to the engine, each with its placed form; placements: where they
    were placed. prolongs: all it does is to prolong a velocity in force.
    """

    event_seq: int
    kind: str
    received_at: float
    dirty_from: int
    placements: tuple[Placement, ...] = ()
    left_open: tuple[tuple[Unplaced, Constraint], ...] = ()
    prolongs: bool = False

    def with_open_of(self, held: Container[int]) -> PendingEdit:
        """The same edit, without left_open items that are no longer set. held: the id() of each constraint set."""
        left = tuple(each for each in self.left_open if id(each[1]) in held)
        return self if len(left) == len(self.left_open) else replace(self, left_open=left)

    def done(self, session: SessionKey, frame: int) -> Outcome:
        """The answer: in effect from `frame` on."""
        return Outcome(session, self.event_seq, Code.OK, frame, placements=self.placements)


class Edited(NamedTuple):
    """The conditions after an event. kind: the kind of edit; dirty_from: the first frame to change, None for none.

    placements, left_open, prolongs: as in PendingEdit.
    """

    conditions: Conditions
    kind: str
    dirty_from: int | None
    placements: tuple[Placement, ...] = ()
    left_open: tuple[tuple[Unplaced, Constraint], ...] = ()
    prolongs: bool = False


def edited(
    held: Conditions,
    event: EditEvent,
    *,
    floor: int,
    reach: int,
    config: EngineConfig,
    anchor: Callable[[], Anchor],
    gaits: Sequence[Gait] = (),
) -> Edited:
    """Apply an event to conditions.

    floor: the first frame that can still change; reach: how many frames a window that starts there sees; anchor: for
    constraints relative to the character; gaits: prompts in force while a velocity is.

    Raises EventRefused if the event cannot be applied.
    """
    match event:
        case SetPrompts():
            conditions, dirty_from = edit_prompts(held, event, floor, config.max_prompts)
            return Edited(conditions, "prompts", dirty_from)
        case SetVelocity():
            velocity, changed_at, prolongs = changed_velocity(held.velocity, event, floor)
            conditions = replace(held, velocity=velocity, gait=gait_of(gaits, event, held.gait_at(floor)))
            dirty_from = conditions.first_change(held, floor, changed_at)
            return Edited(conditions, "velocity", dirty_from, prolongs=prolongs and dirty_from == changed_at)
        case SetConstraints():
            conditions, changed, placements = edit_constraints(
                held, event, floor, config.max_constraints, config.max_held_trajectory_frames, anchor
            )
            # Constraints beyond the reach take effect with the later window that sees them.
            first = min((item.first_frame for item in changed if item.last_frame >= floor), default=None)
            dirty_from = None if first is None else max(floor, first - reach + 1)
            by_id = {item.constraint_id: item for item in conditions.constraints}
            # Of several with one id the last is set, and only that one may be placed again later.
            asked = [item for item in by_last(event.upsert) if isinstance(item, Unplaced)]
            left_open = tuple((item, by_id[item.constraint_id]) for item in asked)
            return Edited(conditions, "constraints", dirty_from, placements, left_open)


@dataclass(slots=True)
class EditQueue:
    """The edits of one session for which no window has started yet, and when the next one may start for them.

    not_before: the earliest start of a window for an edit, so that edits share windows; minus infinity: at once.
    turn_at: when the next replan would start if all were a period apart; it is ahead of the clock by as much as they
    came closer together. unseen: edits whose plan has landed, each with the frame at which it takes effect, until that
    frame is sent.
    """

    most: int
    waiting: tuple[PendingEdit, ...] = ()
    not_before: float = -math.inf
    turn_at: float = -math.inf
    unseen: list[tuple[PendingEdit, int]] = field(default_factory=list)

    @property
    def are_left_open(self) -> bool:
        """Whether a waiting edit has constraints whose placing it left to the engine."""
        return any(edit.left_open for edit in self.waiting)

    @property
    def only_prolong(self) -> bool:
        """Whether all waiting edits merely prolong a velocity; true if none wait."""
        return all(edit.prolongs for edit in self.waiting)

    def apart_by_cuts(self) -> tuple[tuple[PendingEdit, ...], tuple[PendingEdit, ...], tuple[PendingEdit, ...]]:
        """The waiting edits in three parts: before the first cut, from the first to the last one, and after that."""
        cuts = [index for index, edit in enumerate(self.waiting) if edit.kind == SEEK] or [len(self.waiting)]
        return self.waiting[: cuts[0]], self.waiting[cuts[0] : cuts[-1] + 1], self.waiting[cuts[-1] + 1 :]

    def require_room(self) -> None:
        """Raise EventRefused if too many edits wait already."""
        if len(self.waiting) >= self.most:
            raise too_many_pending("edits", self.most)

    def add(self, edit: PendingEdit) -> None:
        self.waiting = (*self.waiting, edit)

    def forget_replaced(self, held: Iterable[Constraint]) -> None:
        """Drop left-open constraints that are no longer set from waiting edits, as they cannot be placed again."""
        if self.are_left_open:
            there = {id(item) for item in held}
            self.waiting = tuple(edit.with_open_of(there) for edit in self.waiting)

    def take(self) -> tuple[PendingEdit, ...]:
        """Remove and return all waiting edits, for a window that starts now."""
        taken, self.waiting = self.waiting, ()
        return taken

    def wait_until(self, at: float) -> None:
        """Start no window that can wait, that is, a replan's or a clip's, before this time."""
        self.not_before = max(self.not_before, at)

    def space_replans(self, now: float, period_s: float, rest_s: float) -> None:
        """A window starts for the waiting edits, or to correct the character: set the earliest start of the next one.

        That is rest_s later, and on average one per period_s. Edits may save up one turn in a quiet time, so that two
        edits in quick succession are answered by two windows. Times count from when this window could have started, at
        most one period ago: otherwise a client that edits as often as allowed would fall behind a little with every
        wait and never catch up.
        """
        asked_at = min((edit.received_at for edit in self.waiting), default=now)
        rested_at = max(self.not_before, asked_at, now - rest_s) + rest_s
        turn_at = max(self.turn_at, asked_at, now - period_s)
        self.turn_at = turn_at + period_s
        self.not_before = max(rested_at, turn_at if self.waiting else self.turn_at)

    def put_back(self, edits: tuple[PendingEdit, ...]) -> None:
        """The window for these edits was dropped: they wait again, and the next window may start at once."""
        self.waiting = (*edits, *self.waiting)
        self.not_before = self.turn_at = -math.inf

    def settle(self, untouched_from: int) -> list[PendingEdit]:
        """Remove and return the edits of frames that no window covers yet: the one that does will include them.

        Not a seek: its plan does not continue the motion, and must say which event caused it.
        """
        if untouched_from <= 0:
            return []
        is_settled = [edit.dirty_from >= untouched_from and edit.kind != SEEK for edit in self.waiting]
        settled = list(compress(self.waiting, is_settled))
        if settled:
            self.waiting = tuple(edit for edit, gone in zip(self.waiting, is_settled, strict=True) if not gone)
        return settled

    def landed(self, edits: Sequence[PendingEdit], first_frame: int, sent_to: int) -> list[tuple[PendingEdit, int]]:
        """A plan from first_frame on answers these edits. Returns each with the frame at which it takes effect.

        sent_to: the end of the frames sent that are still valid; unseen edits from there on were superseded.
        """
        answered = [(edit.with_open_of(()), max(edit.dirty_from, first_frame)) for edit in edits]
        # Nobody waits for a prolonged velocity, so its delay is not counted as the latency of an edit.
        shows = [(edit, frame) for edit, frame in answered if not edit.prolongs]
        self.unseen = [(edit, frame) for edit, frame in self.unseen if frame < sent_to] + shows
        return answered

    def seen(self, sent_to: int) -> list[PendingEdit]:
        """The edits whose first frame has now been sent; each is returned once."""
        if not self.unseen:
            return []
        seen = [edit for edit, frame in self.unseen if frame < sent_to]
        self.unseen = [(edit, frame) for edit, frame in self.unseen if frame >= sent_to]
        return seen
