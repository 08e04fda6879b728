"""Edit: a change sent to the server, its outcome, and when the first frame that shows it arrived."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterable, Mapping
from typing import Any
from weakref import WeakSet

from motiongen_client.errors import EventRefused, MotiongenError
from motiongen_client.types import Outcome

LOST_MEANWHILE = "its frames passed while the connection was lost"


class Edit:
    """A change that was sent to the server: `await` it for its Outcome, or ignore it.

    Awaiting raises EventRefused if the server refused the change, and SessionEnded or StreamLost if it can no longer be
    answered. A refusal that comes while nobody awaits it is logged as a warning. The server answers when it makes the
    plan that contains the change; for a prompt scheduled far ahead that is only when its frames are generated.

    event_seq: its number in the session; it changes if the session has to be opened anew, and is 0 if the client did
    not accept the change (OUTBOX_FULL). constraint_ids: the ids of the constraints it adds, or the id of the one that
    it replaces (is_replacement); prompt_id: the id of the prompt it sets.
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
        self.is_replacement = False
        self._sent_at_s = sent_at_s
        self.is_awaited = False
        """For the session: whether someone waits, or has waited, for the answer, and hears of a refusal by it."""
        self._first_frame_at_s: float | None = None
        self._answer: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
        self._settled: Outcome | MotiongenError | None = None
        self._acts: list[Callable[[Outcome | MotiongenError], None]] = []  # callbacks of the session
        self._alike: WeakSet[asyncio.Future[Outcome]] = WeakSet()  # futures of the edits that it replaced

    def __await__(self) -> Generator[Any, None, Outcome]:
        self.is_awaited = True
        return asyncio.shield(self._answer).__await__()  # a cancelled awaiter must not cancel it for the others

    def done(self) -> bool:
        """Whether the server has answered or never will, so that awaiting returns or raises at once."""
        return self._answer.done()

    def result(self) -> Outcome:
        """What awaiting returns or raises, once it is `done`; for the blocking client, whose loop may have ended."""
        return self._answer.result()

    @property
    def outcome(self) -> Outcome | None:
        """The server's answer, if it has accepted the change."""
        return self._answer.result() if self._answer.done() and self._answer.exception() is None else None

    @property
    def latency_s(self) -> float | None:
        """Seconds from sending the change to receiving the first frame it changed; None until then."""
        return None if self._first_frame_at_s is None else self._first_frame_at_s - self._sent_at_s

    def when_accepted(self, act: Callable[[], None]) -> None:
        """For the session: call `act` as soon as the server has accepted the change, and never if it does not."""
        self._when_answered(lambda answer: act() if isinstance(answer, Outcome) else None)

    def when_refused(self, act: Callable[[EventRefused], None]) -> None:
        """For the session: call `act` as soon as the change is refused, and never if it is not."""
        self._when_answered(lambda answer: act(answer) if isinstance(answer, EventRefused) else None)

    def _when_answered(self, act: Callable[[Outcome | MotiongenError], None]) -> None:
        """Call it at once, not via the event loop: the server's next update may refer to its consequences."""
        if self._settled is None:
            self._acts.append(act)
        else:
            act(self._settled)

    def note_first_frame(self, now_s: float) -> None:
        """For the session: the first frame that shows it has arrived. Only the first call counts."""
        if self._first_frame_at_s is None:
            self._first_frame_at_s = now_s

    def take_the_place_of(self, earlier: Edit) -> None:
        """For the session: it was sent instead of an earlier edit, which then gets the same answer."""
        self._alike = earlier._alike
        self._alike.add(earlier._answer)

    def settle(self, answer: Outcome | MotiongenError) -> None:
        """For the session: the answer, or why there will be none. Only the first call counts."""
        if self._settled is not None:
            return
        self._settled = answer
        for future in (self._answer, *self._alike):
            if future.done():
                continue
            if isinstance(answer, Outcome):
                future.set_result(answer)
            else:
                future.set_exception(answer)
                future.exception()  # marks it as seen; asyncio would otherwise report it as a bug if nobody awaits it
        acts, self._acts = self._acts, []
        for act in acts:
            act(answer)


class EditBook:
    """The edits of a session that are unanswered, and those that no received frame shows yet."""

    def __init__(self) -> None:
        self._unanswered: dict[int, Edit] = {}  # by event number
        self._unseen: dict[Edit, int] = {}  # each with the first frame that shows it

    @property
    def is_waiting(self) -> bool:
        """Whether any edit is unanswered."""
        return bool(self._unanswered)

    def add(self, edit: Edit) -> None:
        """Add an edit that was sent."""
        self._unanswered[edit.event_seq] = edit

    def put_in_place(self, edit: Edit) -> None:
        """Add an edit that replaces the unanswered edit with the same number."""
        edit.take_the_place_of(self._unanswered[edit.event_seq])
        self._unanswered[edit.event_seq] = edit

    def find(self, event_seq: int) -> Edit | None:
        """The unanswered edit with that number, if any."""
        return self._unanswered.get(event_seq)

    def plan(self, event_seqs: Iterable[int], valid_from: int) -> None:
        """Note that a plan was announced in which these events first take effect."""
        for seq in event_seqs:
            if (edit := self._unanswered.get(seq)) is not None:
                self._unseen[edit] = min(valid_from, self._unseen.get(edit, valid_from))

    def answer(self, edit: Edit, answer: Outcome | EventRefused) -> None:
        """Settle an edit with the server's answer."""
        del self._unanswered[edit.event_seq]
        edit.settle(answer)
        is_planned = edit.latency_s is not None or edit in self._unseen
        if isinstance(answer, Outcome) and answer.effective_frame is not None and not is_planned:
            self._unseen[edit] = answer.effective_frame  # it takes effect beyond everything planned so far

    def receive(self, end_frame: int, now_s: float) -> None:
        """Note that frames up to end_frame - 1 have arrived."""
        if not self._unseen:
            return
        for edit, frame in self._unseen.items():
            if frame < end_frame:
                edit.note_first_frame(now_s)
        self._unseen = {edit: frame for edit, frame in self._unseen.items() if frame >= end_frame}

    def renumber(self, numbers: Mapping[int, int]) -> None:
        """Give the events new numbers (old -> new). Events without one will not be sent again: they are refused."""
        unanswered, self._unanswered = self._unanswered, {}
        for number, edit in unanswered.items():
            if number in numbers:
                edit.event_seq = numbers[number]
                self._unanswered[edit.event_seq] = edit
            else:
                edit.settle(EventRefused(edit.what, "FAILED_PRECONDITION", "FRAME_COMMITTED", LOST_MEANWHILE))

    def fail(self, failure: MotiongenError) -> None:
        """Settle all edits with a failure: nothing more will be answered."""
        for edit in self._unanswered.values():
            edit.settle(failure)
        self._unanswered.clear()
        self._unseen.clear()
