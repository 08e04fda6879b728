"""Chain: several of the robot's hinges in a row that act as one joint of a person, with angles within range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from motiongen_client.kinematics import axis_angle_to_quaternion, quaternion_to_matrix
from motiongen_client.robot.g1 import HINGES, INDEX, LOWER, UPPER

Float64 = NDArray[np.float64]
_ROUNDS = 100


class Chain:
    """Hinges in a row. hinges: their names, from the root outward."""

    def __init__(self, hinges: Sequence[str]) -> None:
        self.indices = [INDEX[name] for name in hinges]
        self._fixed = quaternion_to_matrix(np.array([HINGES[index].quaternion_wxyz for index in self.indices]))
        self._axes = np.array([HINGES[index].axis for index in self.indices])

    def rotation(self, angles: Float64) -> Float64:
        """(T, 3, 3) the last body's rotation relative to the first hinge's parent, for angles (T, K); robot axes."""
        return self._product(angles, range(len(self.indices)))

    def angles(self, asked: Float64, start: Float64) -> tuple[Float64, Float64]:
        """Angles (T, K) within range that come nearest to rotations `asked` (T, 3, 3), and their errors (T,), radians.

        Coordinate ascent: each hinge in turn is set to the angle that maximizes the trace of asked^T made, with the
        others fixed, until nothing changes; for a single hinge this is exact. start: (T, K), where to begin; of two
        solutions for the same rotation, the one nearer to it is found.
        """
        angles = np.clip(start, LOWER[self.indices], UPPER[self.indices]).astype(np.float64)
        for _ in range(_ROUNDS if len(self.indices) > 1 else 1):
            before = angles.copy()
            for hinge, index in enumerate(self.indices):
                above = self._product(angles, range(hinge)) @ self._fixed[hinge]
                below = self._product(angles, range(hinge + 1, len(self.indices)))
                wanted = np.swapaxes(above, -1, -2) @ asked @ np.swapaxes(below, -1, -2)
                best = _angle_about(self._axes[hinge], wanted)
                middle = (LOWER[index] + UPPER[index]) / 2
                best = middle + np.remainder(best - middle + np.pi, 2 * np.pi) - np.pi
                angles[:, hinge] = np.clip(best, LOWER[index], UPPER[index])
            if np.abs(angles - before).max() < 1e-7:
                break
        made = self.rotation(angles)
        cosine = (np.einsum("tij,tij->t", made, asked) - 1) / 2
        return angles, np.asarray(np.arccos(np.clip(cosine, -1, 1)), np.float64)

    def _product(self, angles: Float64, hinges: range) -> Float64:
        """The product of the rotations of some hinges, each with its fixed part."""
        turned = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
        for hinge in hinges:
            turned = turned @ self._turn(hinge, angles[:, hinge])
        return np.asarray(turned, np.float64)

    def _turn(self, hinge: int, angles: Float64) -> Float64:
        about = quaternion_to_matrix(axis_angle_to_quaternion(angles[:, None] * self._axes[hinge]))
        return np.asarray(self._fixed[hinge] @ about, np.float64)


def _angle_about(axis: Float64, rotations: Float64) -> Float64:
    """(T,) the angles about an axis (3,) whose rotations are nearest to given ones (T, 3, 3)."""
    twice = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=-1,
    )
    along = np.einsum("i,tij,j->t", axis, rotations, axis)
    trace = np.trace(rotations, axis1=-2, axis2=-1)
    return np.asarray(np.arctan2(twice @ axis, trace - along), np.float64)
