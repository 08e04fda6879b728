"""Quaternions of messages and frame rows as rotation matrices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FEW = 8
"""Up to this many quaternions are converted one by one, which is faster than a call of numpy for all."""


def rotation_matrices(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 4) quaternions w x y z of any length but zero -> (..., 3, 3)."""
    w, x, y, z = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(entries, axis=-1).reshape(*w.shape, 3, 3)


def rotation_matrices_of_few(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(K, 4) quaternions w x y z of finite length but zero -> (K, 3, 3), bit for bit as from `rotation_matrices`."""
    if len(quaternions) > FEW:
        return rotation_matrices(quaternions)
    return np.array([_entries(*each) for each in quaternions.tolist()]).reshape(-1, 3, 3)


def _entries(w: float, x: float, y: float, z: float) -> tuple[float, ...]:
    length = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / length, x / length, y / length, z / length
    return (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
