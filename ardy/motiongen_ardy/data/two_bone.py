"""A leg put to a wanted ankle: the analytic two-bone solution, for all frames of a motion at once.

Positions are metres, matrices act on column vectors, everything is float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# No leg is stretched beyond this share of its length: there, small moves of the hip make the knee jump.
MAX_REACH = 0.995
MIN_REACH = 0.25
# What the hinge's own forward counts beside the knee's offset, metres: it decides for a leg that is nearly straight.
HINGE_HINT_M = 0.02


@dataclass(frozen=True)
class SolvedLeg:
    """Global rotations (T, 3, 3) of thigh and shin, and how far (T,) metres the ankle stays short of its goal."""

    thigh: np.ndarray
    shin: np.ndarray
    short_m: np.ndarray


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) at length 1; zero stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotations (..., 3, 3) that take the unit vectors start (..., 3) to end."""
    cross = np.cross(start, end)
    cosine = (start * end).sum(-1)[..., None, None]
    skew = np.zeros((*cross.shape, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -cross[..., 2], cross[..., 1], -cross[..., 0]
    skew[..., 1, 0], skew[..., 2, 0], skew[..., 2, 1] = cross[..., 2], -cross[..., 1], cross[..., 0]
    return np.eye(3) + skew + skew @ skew / np.maximum(1 + cosine, 1e-6)


def solve_leg(
    hip: np.ndarray,
    goal: np.ndarray,
    thigh: np.ndarray,
    shin: np.ndarray,
    knee_bone: np.ndarray,
    ankle_bone: np.ndarray,
) -> SolvedLeg:
    """Turn a leg as little as can be so that its ankle comes to `goal`.

    hip, goal: (T, 3). thigh, shin: (T, 3, 3) global rotations as they are. knee_bone, ankle_bone: (3,) offsets of knee
    and ankle in the frames of thigh and shin. The knee keeps its side: it bends in the plane in which it is bent now,
    and where it is nearly straight, forward of the thigh's own left axis.
    """
    upper, lower = float(np.linalg.norm(knee_bone)), float(np.linalg.norm(ankle_bone))
    knee = thigh @ knee_bone
    ankle = knee + shin @ ankle_bone
    was, wanted = unit(ankle), goal - hip
    distance = np.linalg.norm(wanted, axis=-1)
    reach = np.clip(distance, MIN_REACH * (upper + lower), MAX_REACH * (upper + lower))
    along = unit(wanted)

    ahead = np.cross(was, thigh[:, :, 0])
    side = knee - (knee * was).sum(-1, keepdims=True) * was + HINGE_HINT_M * unit(ahead)
    side = (between(was, along) @ side[..., None])[..., 0]
    side = unit(side - (side * along).sum(-1, keepdims=True) * along)

    cosine = np.clip((upper**2 + reach**2 - lower**2) / (2 * upper * reach), -1, 1)
    sine = np.sqrt(1 - cosine**2)
    new_knee = upper * (cosine[:, None] * along + sine[:, None] * side)
    new_ankle = reach[:, None] * along
    turned_thigh = between(unit(knee), unit(new_knee)) @ thigh
    turned_shin = between(unit(ankle - knee), unit(new_ankle - new_knee)) @ shin
    return SolvedLeg(turned_thigh, turned_shin, np.maximum(distance - reach, 0))
