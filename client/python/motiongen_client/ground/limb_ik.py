"""Two-bone inverse kinematics: turns hip and knee so that the ankle reaches a goal.

The position of the knee follows from the lengths of the bones and the distance from hip to goal (the law of cosines);
the knee stays in the plane in which the leg is already bent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
_TINY = 1e-9


def two_bone(hip: Float64, knee: Float64, ankle: Float64, goal: Float64, ahead: Float64) -> tuple[Float64, Float64]:
    """World rotations (T, 3, 3) by which to left-multiply those of thigh and shin, so that the ankle reaches `goal`.

    All points: (T, 3) metres. If the goal is beyond the leg's length, the leg points to it. ahead: (T, 3), the
    direction in which the knee bends if the leg is straight.
    """
    thigh, shin = knee - hip, ankle - knee
    upper, lower = _length(thigh), _length(shin)
    reach = goal - hip
    distance = np.clip(_length(reach), np.abs(upper - lower) + _TINY, upper + lower - _TINY)
    toward = reach / np.maximum(_length(reach), _TINY)
    swung = rotation_between(ankle - hip, reach)
    bent = _turned(swung, thigh)
    aside = bent - (bent * toward).sum(-1, keepdims=True) * toward
    straight = _length(aside) < 1e-4
    instead = ahead - (ahead * toward).sum(-1, keepdims=True) * toward
    aside = np.where(straight, instead, aside)
    aside = aside / np.maximum(_length(aside), _TINY)
    along = (upper**2 - lower**2 + distance**2) / (2 * distance)
    new_thigh = along * toward + np.sqrt(np.maximum(upper**2 - along**2, 0.0)) * aside
    new_shin = distance * toward - new_thigh
    first = rotation_between(bent, new_thigh) @ swung
    second = rotation_between(_turned(first, shin), new_shin) @ first
    return first, second


def rotation_between(start: NDArray[np.floating[Any]], end: NDArray[np.floating[Any]]) -> Float64:
    """(..., 3, 3) the smallest rotations from vectors (..., 3) to the directions of others; no two may be opposite."""
    a, b = (np.asarray(each / np.maximum(_length(each), _TINY), np.float64) for each in (start, end))
    cross, cosine = np.cross(a, b), (a * b).sum(-1)[..., None, None]
    zero = np.zeros_like(cross[..., 0])
    x, y, z = np.moveaxis(cross, -1, 0)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*zero.shape, 3, 3)
    return np.asarray(np.eye(3) + skew + skew @ skew / np.maximum(1 + cosine, 1e-6), np.float64)


def _turned(rotations: Float64, vectors: Float64) -> Float64:
    return np.asarray(np.einsum("...ij,...j->...i", rotations, vectors), np.float64)


def _length(vectors: NDArray[np.floating[Any]]) -> Float64:
    return np.asarray(np.linalg.norm(vectors, axis=-1, keepdims=True), np.float64)
