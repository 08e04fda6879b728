"""Arrays from an untrusted NPZ file: sizes are checked before reading; no pickles, no paths."""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.npy import NpyError, read_npy_header
from motiongen_ardy.formats.bounded import MAX_ARRAY_BYTES
from motiongen_ardy.formats.errors import FormatError, shortened

MAX_MEMBERS = 64
_HEADER_BYTES = 16_384
_LAST_CHARACTER = 0x10FFFF
_SURROGATES = 0xD800, 0xDFFF  # halves of characters in UTF-16, which no text can hold alone

Check = Callable[[str, tuple[int, ...]], None]


def array_names(path: Path) -> frozenset[str]:
    """The names of the arrays in an NPZ file. Raises FormatError as `read_arrays` does."""
    with _opened(path) as archive:
        return frozenset(_members(path, archive))


def read_arrays(path: Path, names: Mapping[str, str], check: Check) -> dict[str, np.ndarray]:
    """The arrays of an NPZ file whose names are in `names`; others are ignored.

    names: name -> the kinds of type that it may have, out of "f" float, "i" and "u" integer, "b" bool, "U" text. check:
    called with the name and shape of each array before it is read; raises FormatError for an impossible shape. Raises
    FormatError for a damaged archive, too many or too large members, objects, headers that misstate the size, and text
    that contains invalid characters.
    """
    with _opened(path) as archive:
        members = _members(path, archive)
        return {name: _read(path, archive, members[name], names[name], check) for name in names if name in members}


def as_contacts(path: Path, name: str, values: np.ndarray) -> Tensor:
    """(T, 4) bool: each foot joint is on the ground, from values above a half. Raises FormatError unless finite."""
    if not np.isfinite(values).all():
        raise FormatError(path, f"{name} holds NaN or infinite numbers", "1 is on the ground, 0 is not")
    return torch.from_numpy(values > 0.5)


def as_float32(values: np.ndarray) -> Tensor:
    """Numbers in float32; those out of its range become infinite, without a warning from numpy."""
    with np.errstate(over="ignore"):
        return torch.from_numpy(values.astype(np.float32))


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """The opened archive; any exception while it is open is refused as the file's fault."""
    with path.open("rb") as file:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # numpy warns when it guesses
                with zipfile.ZipFile(file) as archive:
                    yield archive
        except FormatError:
            raise
        except Exception as error:  # zipfile and numpy raise all kinds of errors for untrusted bytes
            given = f"not a readable NPZ: {str(error)[:200] or type(error).__name__}"
            raise FormatError(path, given, "give what numpy.savez writes, whole") from None


def _members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    entries = archive.infolist()
    if len(entries) > MAX_MEMBERS:
        raise FormatError(path, f"{len(entries)} members", f"an NPZ of motion has at most {MAX_MEMBERS}")
    members: dict[str, zipfile.ZipInfo] = {}
    for entry in entries:
        name = entry.filename.removesuffix(".npy")
        plain = entry.filename.endswith(".npy") and not any(part in name for part in ("/", "\\", ".."))
        if not plain or name in members:
            raise FormatError(
                path, f"a member called {shortened(entry.filename)}", "members are plain names, each once"
            )
        members[name] = entry
    declared = sum(entry.file_size for entry in entries)
    if declared > MAX_ARRAY_BYTES:
        raise FormatError(path, f"{declared} bytes of arrays", f"at most {MAX_ARRAY_BYTES} are read")
    return members


def _read(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo, kinds: str, check: Check) -> np.ndarray:
    name = entry.filename.removesuffix(".npy")
    with archive.open(entry) as file:
        start = io.BytesIO(file.read(min(_HEADER_BYTES, entry.file_size)))
        try:
            header = read_npy_header(start, kinds)
            check(name, header.shape)
            header.check_size(entry.file_size - start.tell())
            array = header.array(start.read() + file.read())
        except NpyError as error:
            allowed = f"its type must be one of {', '.join(kinds)}, and it must be what numpy.savez writes, whole"
            raise FormatError(path, f"{name} is no array: {error}", allowed) from None
    if array.dtype.kind == "U":
        _check_text(path, name, array)
    return array


def _check_text(path: Path, name: str, array: np.ndarray) -> None:
    """Raise FormatError for text that numpy accepts and Python does not: it would fail at first use."""
    codes = np.frombuffer(array.tobytes(), np.dtype("u4").newbyteorder(array.dtype.byteorder))
    bad = codes[(codes > _LAST_CHARACTER) | ((codes >= _SURROGATES[0]) & (codes <= _SURROGATES[1]))]
    if len(bad):
        raise FormatError(path, f"{name} has text with the number {int(bad[0]):#x}", "no character has that number")
