"""Changes on their way to the server: what became of each, and when its first frame came."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterable, Mapping
from typing import Any

from motiongen_client.errors import EventRefused, MotiongenError
from motiongen_client.types import Outcome

LOST_MEANWHILE = "the line was lost, and its frames have passed since"


class Edit:
    """A change on its way to the server: `await` it for its Outcome, or leave it and go on.

    Awaiting raises EventRefused when the server refused the change and SessionEnded or StreamLost when it can no
    longer be answered. A refusal that comes while nobody awaits it is logged as a warning. The server answers when the
    plan that holds the change is made; for a prompt scheduled far ahead that is only when its frames are generated.

    event_seq: its number in the session; another one where the session had to be opened anew. constraint_ids: ids given
    to the constraints it adds; prompt_id: the id of the prompt it sets.
    """

    def __init__(
        self,
        what: str,
        event_seq: int,
        sent_at_s: float,
        constraint_ids: tuple[int, ...] = (),
        prompt_id: int | None = None,
    ) -> None:
        self.what = what
        self.event_seq = event_seq
        self.constraint_ids = constraint_ids
        self.prompt_id = prompt_id
        self._sent_at_s = sent_at_s
        self.is_awaited = False
        """For the session: whether someone waits, or has waited, for the answer, and hears of a refusal by it."""
        self._first_frame_at_s: float | None = None
        self._answer: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()

    def __await__(self) -> Generator[Any, None, Outcome]:
        self.is_awaited = True
        return asyncio.shield(self._answer).__await__()  # one awaiter that gives up must not cancel it for the others

    def done(self) -> bool:
        """Whether the server has answered, or never will: then awaiting returns or raises at once."""
        return self._answer.done()

    @property
    def outcome(self) -> Outcome | None:
        """The server's answer, if it has accepted the change already."""
        return self._answer.result() if self._answer.done() and self._answer.exception() is None else None

    @property
    def latency_s(self) -> float | None:
        """Seconds from sending the change to receiving the first frame it changed; None until then."""
        return None if self._first_frame_at_s is None else self._first_frame_at_s - self._sent_at_s

    def when_accepted(self, act: Callable[[], None]) -> None:
        """For the session: call `act` once the server has accepted the change, and never if it does not."""

        def look(answer: asyncio.Future[Outcome]) -> None:
            if not answer.cancelled() and answer.exception() is None:
                act()

        self._answer.add_done_callback(look)

    def when_refused(self, act: Callable[[EventRefused], None]) -> None:
        """For the session: call `act` where the change is refused, and never if it is not."""

        def look(answer: asyncio.Future[Outcome]) -> None:
            failure = None if answer.cancelled() else answer.exception()
            if isinstance(failure, EventRefused):
                act(failure)

        self._answer.add_done_callback(look)

    def note_first_frame(self, now_s: float) -> None:
        """For the session: its first frame has come. Only the first call counts."""
        if self._first_frame_at_s is None:
            self._first_frame_at_s = now_s

    def settle(self, answer: Outcome | MotiongenError) -> None:
        """For the session: the answer, or why there will be none. Only the first call counts."""
        if self._answer.done():
            return
        if isinstance(answer, Outcome):
            self._answer.set_result(answer)
            return
        self._answer.set_exception(answer)
        self._answer.exception()  # marks it as seen: asyncio would otherwise report an edit nobody awaits as a bug


class EditBook:
    """The edits of a session that have not been answered, and those that have not been seen in a frame."""

    def __init__(self) -> None:
        self._unanswered: dict[int, Edit] = {}  # by event number
        self._unseen: list[tuple[int, Edit]] = []  # with the first frame that shows it

    @property
    def is_waiting(self) -> bool:
        """Whether any was not answered."""
        return bool(self._unanswered)

    def add(self, edit: Edit) -> None:
        """Take an edit that was sent."""
        self._unanswered[edit.event_seq] = edit

    def find(self, event_seq: int) -> Edit | None:
        """The edit that waits for an answer under a number."""
        return self._unanswered.get(event_seq)

    def plan(self, event_seqs: Iterable[int], valid_from: int) -> None:
        """A plan was announced in which these events first take effect."""
        self._unseen += [(valid_from, self._unanswered[seq]) for seq in event_seqs if seq in self._unanswered]

    def answer(self, edit: Edit, answer: Outcome | EventRefused) -> None:
        """The server has answered."""
        del self._unanswered[edit.event_seq]
        edit.settle(answer)
        is_planned = edit.latency_s is not None or any(edit is unseen for _, unseen in self._unseen)
        if isinstance(answer, Outcome) and answer.effective_frame is not None and not is_planned:
            self._unseen.append((answer.effective_frame, edit))  # it shows beyond everything planned so far

    def receive(self, end_frame: int, now_s: float) -> None:
        """Frames up to end_frame - 1 have come."""
        if not self._unseen:
            return
        for frame, edit in self._unseen:
            if frame < end_frame:
                edit.note_first_frame(now_s)
        self._unseen = [(frame, edit) for frame, edit in self._unseen if frame >= end_frame]

    def renumber(self, numbers: Mapping[int, int]) -> None:
        """The events have other numbers from now on; those that have none will not be sent again."""
        unanswered, self._unanswered = self._unanswered, {}
        for number, edit in unanswered.items():
            if number in numbers:
                edit.event_seq = numbers[number]
                self._unanswered[edit.event_seq] = edit
            else:
                edit.settle(EventRefused(edit.what, "FAILED_PRECONDITION", "FRAME_COMMITTED", LOST_MEANWHILE))

    def fail(self, failure: MotiongenError) -> None:
        """Nothing more will be answered."""
        for edit in self._unanswered.values():
            edit.settle(failure)
        self._unanswered.clear()
        self._unseen.clear()
