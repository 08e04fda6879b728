"""Forward kinematics with numpy: joint positions and rotations of frame rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.types import Float32Array, RigLayout
from motiongen_server.engine.types.facts import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK
from motiongen_server.engine.types.rotations import rotation_matrices

Float64 = NDArray[np.float64]


class Posed:
    """Rows as poses. Joint positions are computed once, when they are first asked for.

    Many constraints are measured on the same frames; a `part` shares the result of the whole.
    """

    def __init__(self, rig: RigLayout, rows: Float32Array) -> None:
        """rows: (T, row_width)."""
        self.rig = rig
        self._rows = rows
        self._joints: tuple[Float64, Float64] | None = None
        self._whole: tuple[Posed, slice] | None = None

    def __len__(self) -> int:
        """The number of frames."""
        return len(self._rows)

    def part(self, begin: int, end: int) -> Posed:
        """The frames from `begin` up to, but not including, `end`, counted from the first of these."""
        part = Posed(self.rig, self._rows[begin:end])
        part._whole = self, slice(begin, end)
        return part

    def root(self) -> Float64:
        """(T, 3) metres: the root's positions."""
        start = _column(self.rig, ROOT_BLOCK)
        return self._rows[:, start : start + 3].astype(np.float64)

    def joints(self) -> tuple[Float64, Float64]:
        """Positions (T, J, 3), metres, and rotations (T, J, 3, 3) of all joints, in the world."""
        if self._joints is None:
            self._joints = self._forward() if self._whole is None else self._of_whole(*self._whole)
        return self._joints

    @staticmethod
    def _of_whole(whole: Posed, frames: slice) -> tuple[Float64, Float64]:
        positions, rotations = whole.joints()
        return positions[frames], rotations[frames]

    def _forward(self) -> tuple[Float64, Float64]:
        rig = self.rig
        start, joints = _column(rig, ROTATION_BLOCK), len(rig.joint_names)
        quaternions = self._rows[:, start : start + 4 * joints].astype(np.float64)
        rotations = rotation_matrices(quaternions.reshape(len(self), joints, 4))
        positions = np.empty((len(self), joints, 3))
        positions[:, 0] = self.root()
        for joint, parent in enumerate(rig.parents[1:], 1):  # parents precede their children
            offset = rig.neutral_offsets[joint].astype(np.float64)
            positions[:, joint] = positions[:, parent] + rotations[:, parent] @ offset
            rotations[:, joint] = rotations[:, parent] @ rotations[:, joint]
        return positions, rotations

    def heading(self) -> Float64:
        """(T) radians about the up axis, 0 toward +Z: from the line between the hips, or without hips from the root."""
        positions, rotations = self.joints()
        if self.rig.hip_joints is None:
            return np.arctan2(rotations[:, 0, 0, 2], rotations[:, 0, 2, 2])
        right, left = self.rig.hip_joints
        return heading_across(positions[:, right], positions[:, left])

    def contacts(self) -> Float32Array:
        """The contact block (T, 4)."""
        start = _column(self.rig, CONTACT_BLOCK)
        return self._rows[:, start : start + 4]


def _column(rig: RigLayout, name: str) -> int:
    """The column at which a block begins in a row."""
    start = 0
    for block in rig.blocks:
        if block.name == name:
            break
        start += block.width
    return start


def heading_across(right: Float64, left: Float64) -> Float64:
    """(...) radians: the heading of hips at right and left, (..., 3) metres: the line between them, turned by 90°."""
    across = right - left
    return np.arctan2(across[..., 2], -across[..., 0])


def continued(rig: RigLayout, rows: Float32Array, before: Float32Array) -> Float32Array:
    """Rows (T, row_width) with quaternion signs chosen to continue those of the row before (row_width).

    q and -q are the same rotation, but a client that interpolates the numbers needs neighbours to be near. Within the
    rows each joint's signs are consistent already, so they are flipped in all rows or in none.
    """
    start = _column(rig, ROTATION_BLOCK)
    columns = slice(start, start + 4 * len(rig.joint_names))
    first, last = rows[0, columns].reshape(-1, 4), before[columns].reshape(-1, 4)
    signs = np.where((first * last).sum(axis=-1) < 0, np.float32(-1), np.float32(1))
    if (signs > 0).all():
        return rows
    turned = rows.copy()
    turned[:, columns] *= np.repeat(signs, 4)
    return turned
