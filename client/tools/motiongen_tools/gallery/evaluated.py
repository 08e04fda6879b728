"""Reads takes that `python -m motiongen_ardy.evaluate --takes FOLDER` wrote, as animations."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from motiongen_client.errors import InvalidInput
from motiongen_tools.gallery.animation import Animation, Goal, feet_of

FORMAT = "motiongen-evaluated-take-1"
MAX_BYTES = 64 << 20
_ARRAYS = ("title", "part", "joint_names", "parents", "frame_rate_hz", "positions_m", "contacts", "goals", "path_m")
_BROKEN = (
    OSError, ValueError, LookupError, TypeError, ArithmeticError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error
)  # fmt: skip


def read_takes(folder: Path) -> list[tuple[str, str, Animation]]:
    """All takes of a folder: for each, the part of the evaluation, the title and the take. Raises InvalidInput."""
    if not folder.is_dir():
        raise InvalidInput(
            "--takes", str(folder), "a folder that the evaluation wrote: make gate ARGS='--takes FOLDER'"
        )
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise InvalidInput("--takes", f"{folder}, which has none", "a folder with takes: *.npz")
    return [_read(path) for path in paths]


def _read(path: Path) -> tuple[str, str, Animation]:
    if path.stat().st_size > MAX_BYTES:
        raise InvalidInput("--takes", str(path), f"files of at most {MAX_BYTES >> 20} MiB")
    try:
        return _take_of(path)
    except InvalidInput as error:
        if error.field == "--takes":
            raise
        raise InvalidInput("--takes", f"{path}, whose {error.field} is {error.given}", error.allowed) from None
    except _BROKEN as error:  # an incomplete file of an interrupted evaluation, or other arrays
        raise InvalidInput("--takes", str(path), f"an NPZ file of the form {FORMAT}: {error}") from None


def _take_of(path: Path) -> tuple[str, str, Animation]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
        arrays: dict[str, Any] = {name: data[name] for name in ("format", *_ARRAYS) if name in data}
    missing = [name for name in _ARRAYS if name not in arrays]
    if missing or str(arrays.get("format")) != FORMAT:
        raise InvalidInput("--takes", str(path), f"a file of the form {FORMAT}; missing: {', '.join(missing) or 'it'}")
    names = tuple(str(name) for name in arrays["joint_names"])
    goals = [Goal(int(frame), np.array([[x, 0.01, z]], np.float32)) for frame, x, z in arrays["goals"]]
    if len(arrays["path_m"]):
        goals.append(Goal(None, np.insert(arrays["path_m"].astype(np.float32), 1, 0.01, axis=1), is_path=True))
    animation = Animation(
        arrays["positions_m"].astype(np.float32), arrays["contacts"].astype(bool), feet_of(names),
        tuple(int(parent) for parent in arrays["parents"]), names, int(arrays["frame_rate_hz"]), tuple(goals),
    )  # fmt: skip
    return str(arrays["part"]), str(arrays["title"]), animation
