"""Arrays from `.npy` bytes of unknown origin: no pickles, and nothing is allocated before size and header agree."""

from __future__ import annotations

import io
import math
import warnings

import numpy as np

MAX_HEADER_BYTES = 10_000
MAGIC = b"\x93NUMPY"


class NpyError(ValueError):
    """Raised for bytes that are not one plain numeric array; the message says what was found."""


def read_npy(content: bytes) -> np.ndarray:
    """The array that `content` holds: numbers or booleans only, exactly as long as its header says.

    Raises NpyError for everything else: Python objects (pickles), text, a header that does not fit the bytes. The
    result shares memory with `content` and cannot be written to.
    """
    stream = io.BytesIO(content)
    if content[: len(MAGIC)] != MAGIC:
        raise NpyError(f"it starts with {content[:6]!r}, not with the magic number of .npy files")
    try:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy warns where it guesses
            shape, fortran_order, dtype = read_header(stream, max_header_size=MAX_HEADER_BYTES)
    except Exception as error:  # numpy's parser meets bytes of anybody's making; whatever it raises, they are refused
        raise NpyError(f"its header cannot be read ({str(error)[:200] or type(error).__name__})") from error
    if dtype.hasobject or dtype.kind not in "biuf":
        raise NpyError(f"it holds {str(dtype)[:60]} entries, not numbers; Python objects are never read")
    if any(length < 0 for length in shape):
        raise NpyError(f"its header claims the shape {str(shape)[:60]}")
    start = stream.tell()
    needed, present = math.prod(shape) * dtype.itemsize, len(content) - start
    if needed != present:
        raise NpyError(f"its header claims {needed} bytes of data, {str(shape)[:60]} of {dtype}, but it has {present}")
    array = np.frombuffer(content, dtype, offset=start)
    return array.reshape(shape, order="F" if fortran_order else "C")
