"""Rotations packed into 32 bits each by the smallest-three method."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from motiongen_client.motion import Float32

_HALF, _SCALE = 511.5, 511.0 * math.sqrt(2.0)
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def unpacked_quaternions(packed: NDArray[np.uint32]) -> Float32:
    """(...) packed -> (..., 4) unit quaternions w x y z: 2 bits index the greatest component, 10 encode each other."""
    greatest = (packed >> 30).astype(np.intp)
    steps = np.stack([packed >> 20 & 1023, packed >> 10 & 1023, packed & 1023], axis=-1)
    rest = (steps.astype(np.float64) - _HALF) / _SCALE
    quaternions = np.empty((*packed.shape, 4))
    np.put_along_axis(quaternions, _OTHERS[greatest], rest, axis=-1)
    largest = np.sqrt(np.maximum(1.0 - (rest**2).sum(axis=-1, keepdims=True), 0.0))
    np.put_along_axis(quaternions, greatest[..., None], largest, axis=-1)
    unit: Float32 = (quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)).astype(np.float32)
    return unit
