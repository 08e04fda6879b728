"""KeptAnswers: what a session's client may not have heard, to be told again when it resumes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from motiongen_server.engine.types import Outcome
from motiongen_server.rpc.send_queue import PLACEMENT_BYTES, size_of

MAX_KEPT_ANSWERS = 128
"""Of those that a client has not said it heard; more than a second's at the rate that events may come."""
MAX_KEPT_BYTES = 256 << 10
"""Of them, in memory; some 700 placements. All of it is in every record of the session, too."""
PLACEMENT_OBJECT_BYTES = 336
"""Of a placement in memory, with its numbers."""


class KeptAnswers:
    """Outcomes by event number, oldest first. num_bytes: that they take in memory, about.

    Where they are too many, or take too much, the oldest are let go first, which a client has most likely heard: their
    placements and warnings before anything else, so that it still learns what became of the events.
    """

    __slots__ = ("_answers", "num_bytes")

    def __init__(self) -> None:
        self._answers: dict[int, Outcome] = {}
        self.num_bytes = 0

    def __len__(self) -> int:
        return len(self._answers)

    def __iter__(self) -> Iterator[Outcome]:
        return iter(self._answers.values())

    def keep(self, answer: Outcome) -> None:
        """The newest."""
        self._put(answer)
        if len(self._answers) > MAX_KEPT_ANSWERS:
            self._drop(next(iter(self._answers)))
        if self.num_bytes > MAX_KEPT_BYTES:
            self._let_go()

    def confirm(self, answered_seq: int) -> None:
        """The client has heard those to all events up to a number."""
        for number in [number for number in self._answers if number <= answered_seq]:
            self._drop(number)

    def up_to(self, event_seq: int) -> tuple[Outcome, ...]:
        """Those to events up to a number."""
        return tuple(answer for number, answer in self._answers.items() if number <= event_seq)

    def let_go_of_places(self) -> None:
        """Keep what became of the events, and neither placements nor warnings."""
        for answer in list(self._answers.values()):
            if answer.placements or answer.warnings:
                self._put(replace(answer, placements=(), warnings=()))

    def _let_go(self) -> None:
        *older, _ = self._answers.values()
        for answer in older:
            if answer.placements or answer.warnings:
                self._put(replace(answer, placements=(), warnings=()))
                if self.num_bytes <= MAX_KEPT_BYTES:
                    return
        for answer in older:
            self._drop(answer.event_seq)
            if self.num_bytes <= MAX_KEPT_BYTES:
                return

    def _put(self, answer: Outcome) -> None:
        before = self._answers.get(answer.event_seq)
        self._answers[answer.event_seq] = answer
        self.num_bytes += _bytes_of(answer) - (0 if before is None else _bytes_of(before))

    def _drop(self, event_seq: int) -> None:
        self.num_bytes -= _bytes_of(self._answers.pop(event_seq))


def _bytes_of(answer: Outcome) -> int:
    return size_of(answer) + (PLACEMENT_OBJECT_BYTES - PLACEMENT_BYTES) * len(answer.placements)
