"""The edits of one character: whether they were accepted, when they showed, and how to undo them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from motiongen_client.edit import Edit
from motiongen_client.errors import InvalidInput, MotiongenError
from motiongen_client.types import Outcome, Placement
from motiongen_tools.view.fields import Message

MOST_SHOWN = 40
MOST_KEPT = 20_000
NOT_UNDONE = ("set_velocity", "pause", "resume")
WITH_CONSTRAINTS = ("add_constraints", "set_constraints")


@dataclass
class Entry:
    """One edit. at_frame: the playhead when it was sent; takes_back: the messages that undo it, once it is accepted."""

    number: int
    message: Message
    what: str
    at_frame: int
    edit: Edit = field(repr=False)
    takes_back: list[Message] = field(default_factory=list, repr=False)
    can_be_undone: bool = True
    state: str = "sent"
    effective_frame: int | None = None
    latency_ms: int | None = None
    detail: str = ""
    placements: tuple[Placement, ...] = ()

    def shown(self) -> dict[str, Any]:
        return {
            "number": self.number,
            "op": self.message.get("op"),
            "what": self.what,
            "at_frame": self.at_frame,
            "state": self.state,
            "effective_frame": self.effective_frame,
            "latency_ms": self.latency_ms,
            "detail": self.detail,
            "constraint_ids": list(self.edit.constraint_ids),
        }


class EditLog:
    """All edits of one character, including those that can be undone."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self.num_forgotten = 0  # the oldest edits of a long session
        self._undoable: list[Entry] = []
        self._unshown: list[Entry] = []
        self._answering: set[asyncio.Task[None]] = set()
        self._next = 1

    def add(
        self,
        message: Message,
        what: str,
        at_frame: int,
        edit: Edit,
        on_answer: Callable[[Entry], None],
        *,
        can_be_undone: bool,
    ) -> Entry:
        """Note an edit that was sent. on_answer: called once it is answered; sets what undoes it."""
        can_be_undone = can_be_undone and message.get("op") not in NOT_UNDONE
        entry = Entry(self._next, message, what, at_frame, edit, can_be_undone=can_be_undone)
        self._next += 1
        self.entries.append(entry)
        if can_be_undone:
            self._undoable.append(entry)
            del self._undoable[:-MOST_KEPT]
        self.num_forgotten += max(len(self.entries) - MOST_KEPT, 0)
        del self.entries[:-MOST_KEPT]
        task = asyncio.create_task(self._await_answer(entry, on_answer))
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)
        return entry

    async def _await_answer(self, entry: Entry, on_answer: Callable[[Entry], None]) -> None:
        try:
            outcome: Outcome = await entry.edit
        except MotiongenError as refusal:
            entry.state, entry.detail = "refused", str(refusal)
        else:
            entry.state, entry.effective_frame = "accepted", outcome.effective_frame
            entry.detail = "; ".join(warning.message for warning in outcome.warnings)
            entry.placements = outcome.placements
            if "frame" not in entry.message:  # an edit for a later frame shows when its time comes
                self._unshown.append(entry)
        on_answer(entry)
        if entry.can_be_undone and not entry.takes_back:
            self._undoable = [each for each in self._undoable if each is not entry]

    def look(self) -> bool:
        """Whether the first frame of any edit has been shown since the last look."""
        if not self._unshown:
            return False
        came = False
        for entry in self._unshown:
            latency_s = entry.edit.latency_s
            if latency_s is not None:
                entry.latency_ms = round(1000 * latency_s)
                came = True
        self._unshown = [entry for entry in self._unshown if entry.latency_ms is None][-MOST_SHOWN:]
        return came

    def pop_undoable(self) -> Entry | None:
        """Take the last edit that can be undone off the stack. Raises InvalidInput while it has no answer."""
        if self._undoable and self._undoable[-1].state == "sent":
            what = self._undoable[-1].what
            raise InvalidInput("op", "undo", f"to undo {what!r} once the server has answered it")
        return self._undoable.pop() if self._undoable else None

    @property
    def latency_ms(self) -> int | None:
        """Latency of the last edit that has shown."""
        return next((e.latency_ms for e in reversed(self.entries[-MOST_SHOWN:]) if e.latency_ms is not None), None)

    def shown(self) -> list[dict[str, Any]]:
        """The last edits, newest first. Of consecutive velocities only the newest, because a held key sends many."""
        listed: list[Entry] = []
        for entry in reversed(self.entries[-4 * MOST_SHOWN :]):
            is_more = listed and entry.message.get("op") == listed[-1].message.get("op") == "set_velocity"
            if not is_more or entry.state == "refused":
                listed.append(entry)
        return [entry.shown() for entry in listed[:MOST_SHOWN]]

    def close(self) -> None:
        """Stop waiting for answers."""
        for task in self._answering:
            task.cancel()


def named(message: Message, what: str) -> str:
    """The name of an edit for the list; for constraints, their kinds."""
    given = message["constraints"] if message.get("op") in WITH_CONSTRAINTS else []
    kinds = [str(one["kind"]).replace("_", " ") for one in given]
    if not kinds:
        return what
    return ", ".join(kinds[:3]) + (f" and {len(kinds) - 3} more" if len(kinds) > 3 else "")
