"""Reading within bounds: the size of a file and the length of a motion are checked before memory is allocated."""

from __future__ import annotations

from pathlib import Path

from motiongen_ardy.formats.errors import FormatError

MAX_TEXT_BYTES = 64 * 2**20
MAX_JSON_BYTES = 16 * 2**20  # takes twenty times as much when parsed
MAX_ARRAY_BYTES = 512 * 2**20
MAX_FRAMES = 200_000


def read_bytes(path: Path, limit: int) -> bytes:
    """The file's bytes. Raises FormatError above `limit` bytes, without reading them, and OSError as `open` does."""
    with path.open("rb") as file:
        content = file.read(limit + 1) if path.stat().st_size <= limit else b""
    size = max(path.stat().st_size, len(content))
    if size > limit:
        raise FormatError(path, f"the file has {size} bytes", f"at most {limit} are read")
    return content


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """The file as UTF-8 text. Raises FormatError above `limit` bytes and for anything that is not UTF-8."""
    try:
        return read_bytes(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(path, f"byte {error.start} is not UTF-8", "give a text file") from None


def check_num_frames(source: object, num_frames: int) -> None:
    """Raise FormatError for no frames or too many."""
    if not 1 <= num_frames <= MAX_FRAMES:
        raise FormatError(source, f"{num_frames} frames", f"give 1 to {MAX_FRAMES}")
