"""Axes: poses in the axes of game engines and robots.

Ours are right-handed, +Y up, +Z forward, +X to the character's left, metres. A change of axes maps every position p to
scale * A p, and every rotation R, of the root and of any joint relative to its parent alike, to A R A^T. The axis of a
rotation is an axial vector, so a quaternion (w, v) becomes (w, det(A) A v).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Axes:
    """An engine's axes. forward, up, left: directions (x, y, z) in its coordinates; scale: its units per metre."""

    name: str
    forward: tuple[int, int, int]
    up: tuple[int, int, int]
    left: tuple[int, int, int]
    scale: float = 1.0

    @cached_property
    def matrix(self) -> Array:
        """(3, 3); the columns are our x (left), y (up) and z (forward) in the engine's axes."""
        return np.array([self.left, self.up, self.forward], np.float64).T

    @cached_property
    def is_left_handed(self) -> bool:
        return bool(np.linalg.det(self.matrix) < 0)

    def positions(self, positions_m: ArrayLike) -> Array:
        """(..., 3) ours, metres -> (..., 3) in the engine's axes and units. Works for a rig's offsets too."""
        return self.scale * (np.asarray(positions_m, np.float64) @ self.matrix.T)

    def quaternions_xyzw(self, quaternions_wxyz: ArrayLike) -> Array:
        """(..., 4) ours, w x y z -> (..., 4) the engine's, x y z w, the order of Unreal, Unity, Godot and ROS."""
        ours = np.asarray(quaternions_wxyz, np.float64)
        sign = -1.0 if self.is_left_handed else 1.0
        return np.concatenate((sign * (ours[..., 1:] @ self.matrix.T), ours[..., :1]), axis=-1)


UNREAL = Axes("Unreal", forward=(1, 0, 0), up=(0, 0, 1), left=(0, -1, 0), scale=100.0)
"""Left-handed, +X forward, +Y right, +Z up, centimetres."""
UNITY = Axes("Unity", forward=(0, 0, 1), up=(0, 1, 0), left=(-1, 0, 0))
"""Left-handed, +Z forward, +X right, +Y up."""
GODOT = Axes("Godot", forward=(0, 0, -1), up=(0, 1, 0), left=(-1, 0, 0))
"""Right-handed, -Z forward (Vector3.FORWARD), +X right, +Y up."""
ROS = Axes("ROS", forward=(1, 0, 0), up=(0, 0, 1), left=(0, 1, 0))
"""Right-handed, +X forward, +Y left, +Z up (REP 103)."""
