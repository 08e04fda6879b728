"""ReachedBook: what became of a session's constraints, kept for a while, and awaited."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable

from motiongen_client.errors import EventRefused, InvalidInput, MotiongenError
from motiongen_client.types import ConstraintReached

MOST_KEPT = 256
"""Limit on remembered constraints, of which long sessions have many."""


class ReachedBook:
    """The constraints of one session whose outcome is known, and those that callers wait for."""

    def __init__(self, expects: Callable[[int], bool]) -> None:
        """expects: whether the outcome of the constraint with an id may still come."""
        self._expects = expects
        self._forgotten_to = 0  # the highest id of those whose outcome is not remembered any more
        self._told: dict[int, ConstraintReached] = {}
        self._heard: dict[tuple[int, int], None] = {}  # id and frame of the latest reports
        self._replacing: Counter[int] = Counter()  # id -> number of unanswered replacements
        self._before: dict[int, ConstraintReached | EventRefused] = {}  # what became of those being replaced
        self._awaited: dict[int, asyncio.Future[ConstraintReached]] = {}
        self._refused: dict[int, EventRefused] = {}
        self._is_replay = False
        self._replaced_from: dict[int, int] = {}  # id -> first frame of a replacement accepted in the replay
        self._failure: MotiongenError | None = None

    def note(self, reached: ConstraintReached, *, is_former: bool = False) -> bool:
        """Take a report. Returns False if it is already known: a server repeats reports to a session that resumes.

        is_former: it concerns a constraint that has since been replaced, so it is the outcome of none that has the id.
        """
        key = reached.constraint_id
        if (key, reached.frame) in self._heard:
            return False
        self._heard[key, reached.frame] = None
        if len(self._heard) > MOST_KEPT:
            del self._heard[next(iter(self._heard))]
        if is_former:
            return True
        if key in self._replacing:
            self._before[key] = reached  # a server reports on the new one only after accepting it
        else:
            self._tell(reached)
        return True

    def begin_replay(self) -> None:
        """The session was resumed. Until frames come, reports follow answers that may have been sent after them."""
        self._is_replay = True

    def end_replay(self) -> None:
        """From now on, answers and reports come in the order in which the server makes them."""
        if self._is_replay:
            self._is_replay = False
            self._replaced_from.clear()

    def replaced_from(self, constraint_id: int) -> int | None:
        """The first frame that a constraint can influence, if it replaced another one, whose report may still come."""
        return self._replaced_from.get(constraint_id)

    def _tell(self, reached: ConstraintReached) -> None:
        key = reached.constraint_id
        self._told.pop(key, None)
        self._told[key] = reached
        self._forget_oldest(self._told)
        waiting = self._awaited.pop(key, None)
        if waiting is not None:
            waiting.set_result(reached)

    def replace(self, constraint_id: int) -> None:
        """A replacement was sent for the constraint with this id: keep what became of the old one apart."""
        self._replacing[constraint_id] += 1
        refused, told = self._refused.pop(constraint_id, None), self._told.pop(constraint_id, None)
        before = told or refused
        if before is not None:
            self._before[constraint_id] = before

    def replaced(self, constraint_id: int, *, is_accepted: bool, effective_frame: int | None = None) -> None:
        """The replacement was accepted and has the id; or refused, so that what became of the old one counts again."""
        if is_accepted and self._is_replay:
            self._replaced_from[constraint_id] = effective_frame or 0
        if constraint_id not in self._replacing:
            return
        self._replacing[constraint_id] -= 1
        is_last = not self._replacing[constraint_id]
        if is_last:
            del self._replacing[constraint_id]
        before = self._before.pop(constraint_id, None) if is_last or is_accepted else None
        if is_accepted:
            return
        if isinstance(before, EventRefused):
            self.refuse([constraint_id], before)
        elif before is not None:
            self._tell(before)
        elif (forgotten := self._forgotten(constraint_id)) is not None:
            self._give_up(self._awaited.pop(constraint_id, None), forgotten)

    def refuse(self, constraint_ids: Iterable[int], refusal: EventRefused) -> None:
        """No server has these constraints, so none will report on them: callers that wait for one get the refusal.

        For an id with an unanswered replacement, they get the replacement's outcome; or, if that is refused too, this.
        """
        for key in constraint_ids:
            if key in self._told:
                continue
            if key in self._replacing:
                self._before.setdefault(key, refusal)
                continue
            self._refused[key] = refusal
            self._forget_oldest(self._refused)
            self._give_up(self._awaited.pop(key, None), refusal)

    async def of(self, constraint_id: int) -> ConstraintReached:
        """Wait for what became of a constraint. Raises its refusal, or the end of the session.

        Raises InvalidInput if it is known no more: it would be waited for until the session's end.
        """
        if constraint_id in self._told:
            return self._told[constraint_id]
        if constraint_id in self._refused:
            raise self._refused[constraint_id]
        if self._failure is not None:
            raise self._failure
        if (forgotten := self._forgotten(constraint_id)) is not None:
            raise forgotten
        waiting = self._awaited.get(constraint_id)
        if waiting is None:
            waiting = self._awaited[constraint_id] = asyncio.get_running_loop().create_future()
        return await asyncio.shield(waiting)  # a cancelled caller must not cancel it for the others

    def fail(self, failure: MotiongenError) -> None:
        """The session is over: no more reports will come."""
        self._failure = failure
        for waiting in self._awaited.values():
            self._give_up(waiting, failure)
        self._awaited.clear()

    def _forget_oldest(self, outcomes: dict[int, ConstraintReached] | dict[int, EventRefused]) -> None:
        if len(outcomes) > MOST_KEPT:
            oldest = next(iter(outcomes))
            del outcomes[oldest]
            self._forgotten_to = max(self._forgotten_to, oldest)

    def _forgotten(self, constraint_id: int) -> InvalidInput | None:
        """The error for a constraint whose outcome may have been forgotten, as no other will come; else None."""
        if constraint_id > self._forgotten_to or self._expects(constraint_id):
            return None
        allowed = f"one that still applies, or whose outcome is among the last {MOST_KEPT}; await it before that"
        return InvalidInput("constraint_id", constraint_id, allowed)

    @staticmethod
    def _give_up(waiting: asyncio.Future[ConstraintReached] | None, failure: MotiongenError) -> None:
        if waiting is not None:
            waiting.set_exception(failure)
            waiting.exception()  # marks it as seen, in case nobody waits any more
