"""Encodes rotations in 32 bits each."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.types import Float32Array

_HALF, _SCALE = 511.5, 511.0 * math.sqrt(2.0)


def smallest_three(quaternions: Float32Array) -> NDArray[np.uint32]:
    """Pack unit quaternions (..., 4) into numbers (...), little endian: the index of the component with the greatest
    magnitude, and ten bits for each of the others."""
    greatest = np.abs(quaternions).argmax(axis=-1)
    sign = np.where(np.take_along_axis(quaternions, greatest[..., None], -1) < 0, -1.0, 1.0)
    others = np.sort((greatest[..., None] + np.arange(1, 4)) % 4, axis=-1)
    rest = np.take_along_axis(quaternions, others, -1) * sign
    steps = np.clip(np.rint(_HALF + _SCALE * rest), 0, 1023).astype(np.uint32)
    packed = greatest.astype(np.uint32) << 30 | steps[..., 0] << 20 | steps[..., 1] << 10 | steps[..., 2]
    return np.asarray(packed, "<u4")
