"""Arrays from untrusted `.npy` bytes: no pickles, and nothing is allocated before size and header agree."""

from __future__ import annotations

import io
import math
import warnings
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

MAX_HEADER_BYTES = 10_000
NUMBERS = "biuf"


class NpyError(ValueError):
    """Raised for bytes that are not one plain array; the message says what was found."""


@dataclass(frozen=True)
class NpyHeader:
    """What a header says about the bytes that follow it. by_column: in Fortran order."""

    shape: tuple[int, ...]
    by_column: bool
    dtype: np.dtype[Any]

    def check_size(self, present: int) -> None:
        """Raise NpyError unless the array has exactly `present` bytes."""
        needed = math.prod(self.shape) * self.dtype.itemsize
        if needed != present:
            said = f"{str(self.shape)[:60]} of {self.dtype}"
            raise NpyError(f"its header claims {needed} bytes of data, {said}, but it has {present} bytes")

    def array(self, content: bytes, offset: int = 0) -> np.ndarray:
        """The array, read-only, sharing memory with `content`. Raises NpyError as `check_size` does."""
        self.check_size(len(content) - offset)
        return np.frombuffer(content, self.dtype, offset=offset).reshape(
            self.shape, order="F" if self.by_column else "C"
        )


def read_npy_header(stream: IO[bytes], kinds: str = NUMBERS) -> NpyHeader:
    """The header at the start of a stream, which is left positioned behind it. kinds: numpy's codes of allowed types.

    Raises NpyError for everything else: Python objects (pickles), other types, and what numpy cannot read.
    """
    try:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy warns when it guesses
            shape, by_column, dtype = read_header(stream, max_header_size=MAX_HEADER_BYTES)
    except Exception as error:  # whatever numpy's parser raises for untrusted bytes: refuse them
        raise NpyError(f"its header cannot be read ({str(error)[:200] or type(error).__name__})") from error
    if dtype.hasobject or dtype.kind not in kinds:
        found = "Python objects (a pickle)" if dtype.hasobject else f"{str(dtype)[:60]} entries"
        raise NpyError(f"it holds {found}, not numbers; Python objects are never read")
    if any(length < 0 for length in shape):
        raise NpyError(f"its header claims the shape {str(shape)[:60]}")
    return NpyHeader(shape, by_column, dtype)


def read_npy(content: bytes) -> np.ndarray:
    """The array in `content`: numbers or booleans only, exactly as long as its header says. Raises NpyError."""
    stream = io.BytesIO(content)
    header = read_npy_header(stream)
    return header.array(content, stream.tell())
