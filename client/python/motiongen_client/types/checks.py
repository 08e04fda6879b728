"""Checks of values before they are sent: numbers, frames, arrays, texts, and the types of everything else.

Each raises InvalidInput, with what was given and what is allowed. A bool is no number, and a text is no list of signs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motiongen_client.errors import InvalidInput

T = TypeVar("T")

MOST_FRAME = 2**53
"""The greatest frame index."""
MOST_UINT32 = 2**32 - 1
_MOST_FLOAT32 = float(np.finfo(np.float32).max)


def check_tolerance(tolerance_m: float | None, tolerance_rad: float | None) -> None:
    """Raise InvalidInput unless both are valid tolerances or None."""
    if tolerance_m is not None:
        allowed = "finite metres, 0 or more, or None"
        check_number("tolerance_m", tolerance_m, allowed, lambda metres: 0 <= metres <= _MOST_FLOAT32)
    if tolerance_rad is not None:
        check_number("tolerance_rad", tolerance_rad, "radians, 0 to pi, or None", lambda angle: 0 <= angle <= np.pi)


def check_finite(name: str, value: float) -> None:
    """Raise InvalidInput unless `value` is a finite number, as float32 too."""
    check_number(name, value, "a finite number", lambda number: abs(number) <= _MOST_FLOAT32)


def check_number(name: str, value: float, allowed: str, is_allowed: Callable[[float], bool]) -> None:
    """Raise InvalidInput unless `value` is a number that is allowed. NaN is not if is_allowed compares it."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not is_number or not _is_float(value) or not is_allowed(value):
        raise InvalidInput(name, value, allowed)


def _is_float(value: float) -> bool:
    try:
        float(value)
    except OverflowError:  # a whole number that no float can hold
        return False
    return True


def check_whole(name: str, value: int, allowed: str, *, least: int = 0, most: int = MOST_UINT32) -> None:
    """Raise InvalidInput unless `value` is a whole number from `least` to `most`."""
    if not is_whole(value) or not least <= value <= most:
        raise InvalidInput(name, value, allowed)


def is_whole(value: object) -> bool:
    """Whether a value is a whole number."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_frame(name: str, value: int) -> None:
    """Raise InvalidInput unless `value` is a frame index."""
    check_whole(name, value, f"a frame index: a whole number from 0 to {MOST_FRAME}", most=MOST_FRAME)


def check_flag(name: str, value: bool) -> None:
    """Raise InvalidInput unless `value` is True or False."""
    check_type(name, value, bool | np.bool_, "True or False")


def check_text(name: str, value: str, allowed: str = "a text that UTF-8 can write") -> None:
    """Raise InvalidInput unless `value` is a text that protobuf can encode.

    Bytes from a terminal that are not UTF-8 become lone surrogates, which it cannot.
    """
    if not isinstance(value, str) or any("\ud800" <= sign <= "\udfff" for sign in value):
        raise InvalidInput(name, value, allowed)


def check_type(name: str, value: object, wanted: Any, allowed: str) -> None:
    """Raise InvalidInput unless `value` is of a type, or of one of a union of types."""
    if not isinstance(value, wanted):
        raise InvalidInput(name, value, allowed)


def as_tuple(name: str, values: Iterable[T], allowed: str) -> tuple[T, ...]:
    """`values` as a tuple. Raises InvalidInput for what cannot be gone through, and for a text or bytes."""
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise InvalidInput(name, values, allowed)
    try:
        return tuple(values)
    except TypeError:  # an array without dimensions
        raise InvalidInput(name, values, allowed) from None


def as_array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float32]:
    """`values` as finite float32 of a shape, in which None stands for any length. Raises InvalidInput."""
    wanted = "(" + ", ".join("N" if size is None else str(size) for size in shape) + ")"
    allowed = f"finite numbers of shape {wanted}"
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "iufO":  # numpy would read the numbers in texts, and take the real part of others
            raise TypeError
        with np.errstate(over="ignore"):  # what is too large for float32 is refused below
            array = given.astype(np.float32, copy=False)
    except (TypeError, ValueError):
        raise InvalidInput(name, values, allowed) from None
    except OverflowError:
        raise InvalidInput(name, "a whole number that no float can hold", allowed) from None
    fits = array.ndim == len(shape) and all(w in (None, s) for w, s in zip(shape, array.shape, strict=True))
    if not fits:
        raise InvalidInput(name, f"shape {array.shape}", allowed)
    if not np.isfinite(array).all():
        raise InvalidInput(name, "a number that is not finite", allowed)
    return array
