"""Session files: how a character was opened and what it was told at which frame, to be played again.

JSON: format, model, seed, options, start, prompt, frames, and `edits`: objects with at_frame (the playhead when it was
said), effective_frame and the message.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motiongen_client.errors import InvalidInput
from motiongen_tools.view import fields
from motiongen_tools.view.character import Character
from motiongen_tools.view.fields import Message

FORMAT = "motiongen-session-1"
MAX_BYTES = 64 << 20
_OPENING = ("text", "preset", "priority", "lookahead_frames", "text_guidance", "constraint_guidance", "keep_prompts")


@dataclass(frozen=True)
class ToldAt:
    """One edit. at_frame: where the playhead was; effective_frame: the first that showed it, if any did."""

    at_frame: int
    effective_frame: int | None
    message: Message


@dataclass(frozen=True)
class SessionFile:
    """opening: as the page asks for a character, with the model, seed and start that it got."""

    opening: Message
    num_frames: int
    edits: tuple[ToldAt, ...]


def session_of(character: Character) -> SessionFile:
    """What a character was told so far; what was refused is left out, as it changed nothing."""
    session, start = character.session, character.options.start
    opening = {key: character.opening[key] for key in _OPENING if character.opening.get(key) is not None}
    opening |= {
        "model": session.opened.model_id,
        "seed": str(session.opened.seed),
        "steps": session.opened.denoise_steps,
        "start": {"x_m": start.x_m, "z_m": start.z_m, "heading_rad": start.heading_rad},
    }
    edits = tuple(
        ToldAt(entry.at_frame, entry.effective_frame, entry.message)
        for entry in character.edits.entries
        if entry.state == "accepted"
    )
    return SessionFile(opening, session.playback.playhead + 1, edits)


def write_session(session: SessionFile) -> str:
    """The file's text."""
    edits = [{"at_frame": e.at_frame, "effective_frame": e.effective_frame, **e.message} for e in session.edits]
    whole = {"format": FORMAT, "opening": session.opening, "num_frames": session.num_frames}
    listed = ",\n    ".join(json.dumps(edit) for edit in edits)
    head = json.dumps(whole, indent=2).removesuffix("\n}")
    return f'{head},\n  "edits": [\n    {listed}\n  ]\n}}\n' if edits else f'{head},\n  "edits": []\n}}\n'


def read_session(path: Path) -> SessionFile:
    """Raises InvalidInput naming the file, the edit and the field."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InvalidInput("file", str(path), f"a file of at most {MAX_BYTES >> 20} MiB")
        whole: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InvalidInput("file", str(path), f"a session file, which is JSON: {error}") from None
    if not isinstance(whole, dict) or whole.get("format") != FORMAT:
        raise InvalidInput("file", str(path), f"a session file of the format {FORMAT}")
    edits = whole.get("edits")
    if not isinstance(edits, list) or not all(isinstance(edit, dict) for edit in edits):
        raise InvalidInput("edits", edits, "a list of objects")
    return SessionFile(
        fields.mapping(whole, "opening"), fields.whole(whole, "num_frames", 1), tuple(map(_read_edit, edits))
    )


def _read_edit(edit: dict[str, Any]) -> ToldAt:
    message = {key: value for key, value in edit.items() if key not in ("at_frame", "effective_frame")}
    return ToldAt(fields.whole(edit, "at_frame"), fields.optional_whole(edit, "effective_frame"), message)
