"""Session files: how a character was opened and which edits it was given at which frame, so that it can be replayed.

JSON: format, `opening` (model, seed, options, start and prompt), num_frames, and `edits`: objects with at_frame (the
playhead when the edit was made), effective_frame, `gave` (the ids that it was given) and the message.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motiongen_client.errors import InvalidInput
from motiongen_tools.view import fields
from motiongen_tools.view.character import Character
from motiongen_tools.view.commands import read
from motiongen_tools.view.edit_log import MOST_KEPT
from motiongen_tools.view.fields import Message
from motiongen_tools.view.rehearsal import ToldAt

FORMAT = "motiongen-session-1"
MAX_BYTES = 64 << 20
_AS_ASKED = (
    "text", "preset", "priority", "lookahead_frames", "text_guidance", "constraint_guidance", "history_frames",
    "keep_prompts",
)  # fmt: skip
OPENING = (*_AS_ASKED, "model", "seed", "steps", "start", "name")
"""The fields of an opening."""


@dataclass(frozen=True)
class SessionFile:
    """opening: as the page asks for a character, with the model, seed and start that it got."""

    opening: Message
    num_frames: int
    edits: tuple[ToldAt, ...]


def session_of(character: Character) -> SessionFile:
    """The edits of a character so far, without those that were refused, which changed nothing."""
    session, start = character.session, character.options.start
    opening = {key: character.opening[key] for key in _AS_ASKED if character.opening.get(key) is not None}
    opening |= {
        "model": session.opened.model_id,
        "seed": str(session.opened.seed),
        "steps": session.opened.denoise_steps,
        "start": {"x_m": start.x_m, "z_m": start.z_m, "heading_rad": start.heading_rad},
    }
    edits = tuple(
        ToldAt(entry.at_frame, entry.effective_frame, entry.message, entry.edit.prompt_id, entry.edit.constraint_ids)
        for entry in character.edits.entries
        if entry.state == "accepted"
    )
    return SessionFile(opening, session.playback.playhead + 1, edits)


def write_session(session: SessionFile) -> str:
    """The text of the file."""
    edits = [
        {"at_frame": e.at_frame, "effective_frame": e.effective_frame, "gave": _ids(e), **e.message}
        for e in session.edits
    ]
    whole = {"format": FORMAT, "opening": session.opening, "num_frames": session.num_frames}
    listed = ",\n    ".join(json.dumps(edit) for edit in edits)
    head = json.dumps(whole, indent=2).removesuffix("\n}")
    return f'{head},\n  "edits": [\n    {listed}\n  ]\n}}\n' if edits else f'{head},\n  "edits": []\n}}\n'


def _ids(edit: ToldAt) -> dict[str, Any]:
    return {"prompt_id": edit.prompt_id, "constraint_ids": list(edit.constraint_ids)}


def read_session(path: Path) -> SessionFile:
    """A session file. Raises InvalidInput naming the file, the edit and the field."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InvalidInput("file", str(path), f"a file of at most {MAX_BYTES >> 20} MiB")
        return parse_session(path.read_bytes(), str(path))
    except OSError as error:
        raise InvalidInput("file", str(path), f"a session file that can be read: {error.strerror}") from None


def parse_session(data: bytes, name: str) -> SessionFile:
    """A session file from its bytes. Raises InvalidInput, also for edits that no server accepts.

    name: of the file, for errors; they name the edit too.
    """
    try:
        whole: Any = json.loads(data)
    except (ValueError, RecursionError) as error:  # ValueError: no UTF-8, no JSON, a number with thousands of digits
        raise InvalidInput("file", name, f"a session file, which is JSON: {error}") from None
    if not isinstance(whole, dict) or whole.get("format") != FORMAT:
        raise InvalidInput("file", name, f"a session file of the format {FORMAT}")
    with naming(name):
        return _read_whole(whole)


@contextlib.contextmanager
def naming(where: str) -> Iterator[None]:
    """Let InvalidInput say in front where the value was found: `walk.json, edits[3], op: ...`."""
    try:
        yield
    except InvalidInput as error:
        raise InvalidInput(f"{where}, {error.field}", error.given, error.allowed) from None


def _read_whole(whole: dict[str, Any]) -> SessionFile:
    edits = whole.get("edits")
    if not isinstance(edits, list) or not all(isinstance(edit, dict) for edit in edits):
        raise InvalidInput("edits", edits, "a list of objects")
    if len(edits) > MOST_KEPT:
        raise InvalidInput("edits", f"{len(edits)} of them", f"at most {MOST_KEPT}, as many as a viewer remembers")
    opening, num_frames = fields.mapping(whole, "opening"), fields.whole(whole, "num_frames", 1)
    return SessionFile(opening, num_frames, tuple(_read_edit(index, edit) for index, edit in enumerate(edits)))


def _read_edit(index: int, edit: dict[str, Any]) -> ToldAt:
    with naming(f"edits[{index}]"):
        return _checked_edit(edit)


def _checked_edit(edit: dict[str, Any]) -> ToldAt:
    message = {key: value for key, value in edit.items() if key not in ("at_frame", "effective_frame", "gave")}
    gave = fields.mapping(edit, "gave") if "gave" in edit else {}
    at_frame = fields.whole(edit, "at_frame")
    read(message)  # only a check: the call is made again when it is due, with other ids
    return ToldAt(
        at_frame,
        fields.optional_whole(edit, "effective_frame"),
        message,
        fields.optional_whole(gave, "prompt_id"),
        tuple(fields.ids(gave, "constraint_ids")) if "constraint_ids" in gave else (),
    )
