"""Rehearsal: a character that is told what another was told, at the same frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motiongen_client.edit import Edit
from motiongen_tools.view.fields import Message

ONLY_PLAYBACK = ("pause", "resume")  # the playhead stood then, and no frame came of it
MOST_AT_ONCE = 64
"""Edits that are told between two looks at the playhead: as many as servers let wait. A file may have any number."""


@dataclass(frozen=True)
class ToldAt:
    """One edit. at_frame: where the playhead was; effective_frame: the first that showed it, if any did.

    prompt_id, constraint_ids: those that the edit was given, by which later ones name what it made.
    """

    at_frame: int
    effective_frame: int | None
    message: Message
    prompt_id: int | None = None
    constraint_ids: tuple[int, ...] = ()


class Rehearsal:
    """Edits that wait for their frame. end_frame: the first that is not played any more."""

    def __init__(self, edits: Iterable[ToldAt], end_frame: int) -> None:
        self.end_frame = end_frame
        self._waiting = sorted(
            (edit for edit in edits if edit.message.get("op") not in ONLY_PLAYBACK), key=lambda edit: edit.at_frame
        )
        self._prompts: dict[int, int] = {}
        self._constraints: dict[int, int] = {}

    def due(self, playhead: int) -> list[ToldAt]:
        """Those whose frame has come, in their order; each once, and the first of very many first.

        Say `told` of one before the next is `renumbered`.
        """
        near = self._waiting[:MOST_AT_ONCE]
        count = next((n for n, edit in enumerate(near) if edit.at_frame > playhead), len(near))
        due, self._waiting = self._waiting[:count], self._waiting[count:]
        return due

    @property
    def left(self) -> list[ToldAt]:
        """Those that were not due yet."""
        return list(self._waiting)

    def renumbered(self, message: Message) -> Message:
        """A message with the ids that this character gave to what it names. What was refused then took ids too."""
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
        """An edit was told again, and has been given its ids."""
        if then.prompt_id is not None and edit.prompt_id is not None:
            self._prompts[then.prompt_id] = edit.prompt_id
        self._note(then.constraint_ids, edit.constraint_ids)

    def _note(self, then: Sequence[int], now: Sequence[int]) -> None:
        if len(then) == len(now):
            self._constraints.update(zip(then, now, strict=True))


def _renumbered(key: Any, book: Mapping[int, int]) -> Any:
    """What is no id stays as it is, for whoever reads the message to refuse."""
    return book.get(key, key) if isinstance(key, int) else key
