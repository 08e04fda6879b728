"""Checks of values before they are sent: numbers, frames, arrays."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motiongen_client.errors import InvalidInput

MOST_FRAME = 2**53
"""The greatest frame index."""


def check_tolerance(tolerance_m: float | None, tolerance_rad: float | None) -> None:
    """Raise InvalidInput unless both are valid tolerances or None."""
    if tolerance_m is not None and not (_is_finite(tolerance_m) and tolerance_m >= 0):
        raise InvalidInput("tolerance_m", tolerance_m, "finite metres, 0 or more, or None")
    if tolerance_rad is not None and not 0 <= tolerance_rad <= np.pi:
        raise InvalidInput("tolerance_rad", tolerance_rad, "radians, 0 to pi, or None")


def check_finite(name: str, value: float) -> None:
    """Raise InvalidInput unless `value` is a finite number."""
    if not isinstance(value, int | float | np.number) or not _is_finite(value):
        raise InvalidInput(name, value, "a finite number")


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number that no float can hold
        return False


def check_frame(name: str, value: int) -> None:
    """Raise InvalidInput unless `value` is a frame index."""
    if not isinstance(value, int | np.integer) or not 0 <= value <= MOST_FRAME:
        raise InvalidInput(name, value, f"a frame index: a whole number from 0 to {MOST_FRAME}")


def as_array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float32]:
    """`values` as finite float32 of a shape, in which None stands for any length. Raises InvalidInput."""
    wanted = "(" + ", ".join("N" if size is None else str(size) for size in shape) + ")"
    allowed = f"finite numbers of shape {wanted}"
    try:
        with np.errstate(over="ignore"):  # what is too large for float32 is refused below
            array = np.asarray(values, dtype=np.float32)
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
