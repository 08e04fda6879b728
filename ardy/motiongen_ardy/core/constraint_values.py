"""Checks and copies the values of constraints: numbers, rotations and frames."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Floats = NDArray[np.float32]
ORTHONORMAL_WITHIN = 0.01


class ConstraintError(ValueError):
    """Raised for a constraint that has no meaning; the message says what was given and what is allowed."""


def require_numbers(what: str, values: Tensor | NDArray[Any], shape: tuple[int, ...]) -> Floats:
    """A float32 copy of values, independent of later changes to what was given.

    Raises ConstraintError unless all are finite and the shape is `shape`.
    """
    given = values.detach().cpu().float().numpy() if isinstance(values, Tensor) else values
    with np.errstate(over="ignore"):  # values too large for float32 become infinite and are refused below
        numbers = np.array(given, np.float32, order="C")
    if numbers.shape != shape:
        raise ConstraintError(f"{what} have shape {numbers.shape}; give {shape}")
    if not np.isfinite(numbers).all():
        raise ConstraintError(f"{what} hold NaN or infinite numbers; every one must be finite")
    return numbers


def require_rotations(values: Tensor | NDArray[Any], shape: tuple[int, ...]) -> Floats:
    """As `require_numbers`, for matrices (..., 3, 3). Raises ConstraintError unless they are rotations within 0.01."""
    turns = require_numbers("joint rotations", values, shape)
    off = np.abs(turns.swapaxes(-1, -2) @ turns - np.eye(3, dtype=np.float32)).max(initial=0.0)
    if not off <= ORTHONORMAL_WITHIN or (np.linalg.det(turns) < 0).any():
        raise ConstraintError("joint rotations hold a matrix that is no rotation; give orthonormal ones, determinant 1")
    return turns


def require_frames(frames: Sequence[int]) -> list[int]:
    """Frames as Python integers. Raises ConstraintError if one is not a whole number, or is negative."""
    try:
        whole = [operator.index(frame) for frame in frames]
    except TypeError:
        raise ConstraintError(f"frames are {str(list(frames))[:80]}; every one must be a whole number") from None
    if any(frame < 0 for frame in whole):
        raise ConstraintError(f"frames hold {min(whole)}; they are counted from 0, the first of the motion")
    return whole
