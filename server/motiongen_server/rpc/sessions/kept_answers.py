"""KeptAnswers: outcomes that a session's client may not have received, to be sent again when it resumes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from motiongen_server.engine.types import Outcome
from motiongen_server.rpc.send_queue import PLACEMENT_BYTES, size_of

MAX_KEPT_ANSWERS = 128
"""Answers that a client has not confirmed; more than one second of events at the highest rate."""
MAX_KEPT_BYTES = 256 << 10
"""Of these answers in memory: about 700 placements. Every record of the session contains them, too."""
PLACEMENT_OBJECT_BYTES = 336
"""A placement in memory, with its numbers."""


class KeptAnswers:
    """Outcomes by event number, oldest first. num_bytes: roughly what they take in memory.

    If they are too many or too large, the oldest are dropped first, as the client has most likely received them. If
    they are too large, placements and warnings go before whole answers, so that it still learns what became of events.
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
        """Keep the newest answer."""
        self._put(answer)
        if len(self._answers) > MAX_KEPT_ANSWERS:
            self._drop(next(iter(self._answers)))
        if self.num_bytes > MAX_KEPT_BYTES:
            self._let_go()

    def confirm(self, answered_seq: int) -> None:
        """The client has received the answers to all events up to a number."""
        for number in [number for number in self._answers if number <= answered_seq]:
            self._drop(number)

    def up_to(self, event_seq: int) -> tuple[Outcome, ...]:
        """The answers to events up to a number."""
        return tuple(answer for number, answer in self._answers.items() if number <= event_seq)

    def let_go_of_places(self) -> None:
        """Drop placements and warnings, but keep what became of the events."""
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
