"""What became of a session's constraints: kept for a while, and waited for."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterable

from motiongen_client.errors import EventRefused, MotiongenError
from motiongen_client.types import ConstraintReached

MOST_KEPT = 256
"""Constraints whose end is remembered; of a session that runs for hours there are many."""


class ReachedBook:
    """The constraints of one session that have been answered, and those that somebody waits for."""

    def __init__(self) -> None:
        self._told: dict[int, ConstraintReached] = {}
        self._heard: dict[tuple[int, int], None] = {}  # id and frame of all that was told of late
        self._replacing: Counter[int] = Counter()  # ids that another constraint is to take, not answered yet
        self._before: dict[int, ConstraintReached | EventRefused] = {}  # of those that have these ids until then
        self._awaited: dict[int, asyncio.Future[ConstraintReached]] = {}
        self._refused: dict[int, EventRefused] = {}
        self._failure: MotiongenError | None = None

    def note(self, reached: ConstraintReached, *, is_former: bool = False) -> bool:
        """Take what was told. False where it is known already: a server repeats itself to a session that resumes.

        is_former: it is of a constraint in whose place another has come since.
        """
        key = reached.constraint_id
        if (key, reached.frame) in self._heard:
            return False
        self._heard[key, reached.frame] = None
        if len(self._heard) > MOST_KEPT:
            del self._heard[next(iter(self._heard))]
        if key in self._replacing:
            self._before[key] = reached  # of the new one a server tells after its answer
        elif not is_former:
            self._tell(reached)
        return True

    def _tell(self, reached: ConstraintReached) -> None:
        key = reached.constraint_id
        self._told.pop(key, None)
        self._told[key] = reached
        if len(self._told) > MOST_KEPT:
            del self._told[next(iter(self._told))]
        waiting = self._awaited.pop(key, None)
        if waiting is not None:
            waiting.set_result(reached)

    def replace(self, constraint_id: int) -> None:
        """Another constraint is to take the id: what became of the one before is not told for it."""
        self._replacing[constraint_id] += 1
        refused, told = self._refused.pop(constraint_id, None), self._told.pop(constraint_id, None)
        before = told or refused
        if before is not None:
            self._before[constraint_id] = before

    def replaced(self, constraint_id: int, *, is_accepted: bool) -> None:
        """It has the id from now on; or was refused, and what became of the one before holds."""
        if constraint_id not in self._replacing:
            return
        self._replacing[constraint_id] -= 1
        is_last = not self._replacing[constraint_id]
        if is_last:
            del self._replacing[constraint_id]
        before = self._before.pop(constraint_id, None) if is_last or is_accepted else None
        if before is None or is_accepted:
            return
        if isinstance(before, EventRefused):
            self.refuse([constraint_id], before)
        else:
            self._tell(before)

    def refuse(self, constraint_ids: Iterable[int], refusal: EventRefused) -> None:
        """No server has these, and none will tell of them: who waits for one, now or later, is told why.

        Who waits for one whose id another is to take hears of that one, or this once that is refused too.
        """
        for key in constraint_ids:
            if key in self._told:
                continue
            if key in self._replacing:
                self._before.setdefault(key, refusal)
                continue
            self._refused[key] = refusal
            if len(self._refused) > MOST_KEPT:
                del self._refused[next(iter(self._refused))]
            self._give_up(self._awaited.pop(key, None), refusal)

    async def of(self, constraint_id: int) -> ConstraintReached:
        """What became of a constraint, once it is told. Raises why it never will be: a refusal, the session's end."""
        if constraint_id in self._told:
            return self._told[constraint_id]
        if constraint_id in self._refused:
            raise self._refused[constraint_id]
        if self._failure is not None:
            raise self._failure
        waiting = self._awaited.get(constraint_id)
        if waiting is None:
            waiting = self._awaited[constraint_id] = asyncio.get_running_loop().create_future()
        return await asyncio.shield(waiting)  # one that gives up must not cancel it for the others

    def fail(self, failure: MotiongenError) -> None:
        """Nothing more will be told."""
        self._failure = failure
        for waiting in self._awaited.values():
            self._give_up(waiting, failure)
        self._awaited.clear()

    @staticmethod
    def _give_up(waiting: asyncio.Future[ConstraintReached] | None, failure: MotiongenError) -> None:
        if waiting is not None:
            waiting.set_exception(failure)
            waiting.exception()  # marks it as seen, where nobody waits any more
