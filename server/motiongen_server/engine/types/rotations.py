"""Quaternions as matrices: those of messages and of frame rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def rotation_matrices(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 4) quaternions w x y z of any length but zero -> (..., 3, 3)."""
    w, x, y, z = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(entries, axis=-1).reshape(*w.shape, 3, 3)
