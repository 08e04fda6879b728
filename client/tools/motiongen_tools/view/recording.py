"""Takes: the played motion of a character as a file of any format."""

from __future__ import annotations

import asyncio
import dataclasses
import tempfile
from pathlib import Path

from motiongen_client.errors import InvalidInput
from motiongen_client.motion import Motion
from motiongen_tools.cli_generate import write_motion
from motiongen_tools.npz import write_npz
from motiongen_tools.view.character import Character
from motiongen_tools.view.constraint_list import write_constraint_list
from motiongen_tools.view.motion_files import FOLDER_PREFIX
from motiongen_tools.view.session_file import session_of, write_session

JSON = "application/json"
BINARY = "application/octet-stream"
SUFFIXES = (".session.json", ".constraints.json", ".controller.csv", ".npz", ".bvh", ".glb", ".csv")


async def write_take(
    character: Character, name: str, first_frame: int | None, end_frame: int | None
) -> tuple[bytes, str, list[str]]:
    """The bytes of a file, its media type, and what the format could not keep.

    first_frame, end_frame: the part of what was played and is kept; None: all of it. Raises InvalidInput or
    ConversionFailed.
    """
    suffix = next((each for each in SUFFIXES if name.endswith(each)), None)
    if suffix is None:
        raise InvalidInput("name", name, f"a name that ends in {', '.join(SUFFIXES)}")
    if suffix == ".session.json":
        gone = character.edits.num_forgotten
        said = [f"the first {gone} edits are not kept, and are not in the file"] if gone else []
        text = await asyncio.to_thread(write_session, session_of(character))  # there may be thousands of edits
        return text.encode(), JSON, said
    if not character.session.playback.started:
        raise InvalidInput("frames", "none", "a character that has played a frame")
    take = character.session.motion(first_frame, end_frame)
    if suffix == ".constraints.json":
        targets = [dataclasses.replace(each) for each in character.script.targets.values()]  # their state now
        text, left_out = await asyncio.to_thread(write_constraint_list, targets, take)  # fitting a limb takes a while
        return text.encode(), JSON, left_out
    prompts = "; then ".join(str(span.message.get("text") or span.message["preset"]) for span in character.script.spans)
    data, warnings = await asyncio.to_thread(_convert, suffix, take, prompts)
    return data, BINARY, warnings


def _convert(suffix: str, take: Motion, prompts: str) -> tuple[bytes, list[str]]:
    with tempfile.TemporaryDirectory(prefix=FOLDER_PREFIX) as folder:
        path = Path(folder) / f"take{suffix}"
        warnings: list[str] = []
        if suffix == ".npz":
            write_npz(path, take)
        else:
            warnings = write_motion(path, take, prompts, None)
        return path.read_bytes(), warnings
