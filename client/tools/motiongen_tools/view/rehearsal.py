"""Rehearsal: repeats the edits of one character on another, at the same frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motiongen_client.edit import Edit
from motiongen_tools.view.fields import Message

ONLY_PLAYBACK = ("pause", "resume")  # they only affected the playhead, not the frames
MOST_AT_ONCE = 64
"""Most edits that are repeated between two looks at the playhead: servers let no more wait. A file may have more."""


@dataclass(frozen=True)
class ToldAt:
    """One edit. at_frame: where the playhead was; effective_frame: the first frame that showed it, if any did.

    prompt_id, constraint_ids: the ids that the edit was given, by which later edits refer to what it made.
    """

    at_frame: int
    effective_frame: int | None
    message: Message
    prompt_id: int | None = None
    constraint_ids: tuple[int, ...] = ()


class Rehearsal:
    """Edits that wait for their frame. end_frame: the first frame that is not played any more."""

    def __init__(self, edits: Iterable[ToldAt], end_frame: int) -> None:
        self.end_frame = end_frame
        self._waiting = sorted(
            (edit for edit in edits if edit.message.get("op") not in ONLY_PLAYBACK), key=lambda edit: edit.at_frame
        )
        self._prompts: dict[int, int] = {}
        self._constraints: dict[int, int] = {}

    def due(self, playhead: int) -> list[ToldAt]:
        """The edits whose frame has come, in order, each once. Of very many, only the first are returned now.

        Call `told` for each before the next is `renumbered`.
        """
        near = self._waiting[:MOST_AT_ONCE]
        count = next((n for n, edit in enumerate(near) if edit.at_frame > playhead), len(near))
        due, self._waiting = self._waiting[:count], self._waiting[count:]
        return due

    @property
    def left(self) -> list[ToldAt]:
        """The edits that were not due yet."""
        return list(self._waiting)

    def renumbered(self, message: Message) -> Message:
        """A message with this character's ids for what it refers to. Edits that were refused had ids, too."""
        moved = dict(message)
        for one, several, book in (
            ("prompt_id", "prompt_ids", self._prompts),
            ("constraint_id", "constraint_ids", self._constraints),
        ):
            if one in moved:
                moved[one] = _renumbered(moved[one], book)
            if isinstance(moved.get(several), list):
                moved[several] = [_renumbered(key, book) for key in moved[several]]
        return moved

    def told(self, then: ToldAt, edit: Edit) -> None:
        """Note that an edit was repeated, and which ids it was given."""
        if then.prompt_id is not None and edit.prompt_id is not None:
            self._prompts[then.prompt_id] = edit.prompt_id
        self._note(then.constraint_ids, edit.constraint_ids)

    def _note(self, then: Sequence[int], now: Sequence[int]) -> None:
        if len(then) == len(now):
            self._constraints.update(zip(then, now, strict=True))


def _renumbered(key: Any, book: Mapping[int, int]) -> Any:
    """The present ids for recorded ones. What is not an id stays as it is: reading the message will refuse it."""
    return book.get(key, key) if isinstance(key, int) else key
