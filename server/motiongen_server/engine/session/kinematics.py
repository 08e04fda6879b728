"""Forward kinematics with numpy: where the joints of frames are that go over the wire."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.types import Float32Array, RigLayout
from motiongen_server.engine.types.facts import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK
from motiongen_server.engine.types.rotations import rotation_matrices

Float64 = NDArray[np.float64]


class Posed:
    """Rows as poses: world positions and rotations of the joints that are asked for, and of those they hang from.

    positions: (T, 3) metres by joint; rotations: (T, 3, 3) by joint.
    """

    def __init__(self, rig: RigLayout, rows: Float32Array, joints: Iterable[int]) -> None:
        """rows: (T, row_width). joints: which are asked for; the root always is."""
        self._rig = rig
        columns, start = {}, 0
        for block in rig.blocks:
            columns[block.name] = start
            start += block.width
        needed = {0}
        for joint in joints:
            while joint not in needed:
                needed.add(joint)
                joint = rig.parents[joint]
        order = sorted(needed)  # parents precede their children
        quaternions = rows[:, columns[ROTATION_BLOCK] :].astype(np.float64)
        local = rotation_matrices(np.stack([quaternions[:, 4 * joint : 4 * joint + 4] for joint in order]))
        root = columns[ROOT_BLOCK]
        self.positions: dict[int, Float64] = {0: rows[:, root : root + 3].astype(np.float64)}
        self.rotations: dict[int, Float64] = {0: local[0]}
        for index, joint in enumerate(order[1:], 1):
            parent = rig.parents[joint]
            self.rotations[joint] = self.rotations[parent] @ local[index]
            offset = rig.neutral_offsets[joint].astype(np.float64)
            self.positions[joint] = self.positions[parent] + self.rotations[parent] @ offset

    def heading(self) -> Float64:
        """(T) radians about the up axis, 0 toward +Z: from the line of the hips, or the root's rotation without them.

        The hips must be among the joints that were asked for.
        """
        if self._rig.hip_joints is None:
            turn = self.rotations[0]
            return np.arctan2(turn[:, 0, 2], turn[:, 2, 2])
        right, left = self._rig.hip_joints
        return heading_across(self.positions[right], self.positions[left])


def contacts_of(rig: RigLayout, rows: Float32Array) -> Float32Array:
    """The contact block (T, 4) of rows (T, row_width)."""
    start = 0
    for block in rig.blocks:
        if block.name == CONTACT_BLOCK:
            break
        start += block.width
    return rows[:, start : start + block.width]


def heading_across(right: Float64, left: Float64) -> Float64:
    """(...) radians: where hips at right and left, (..., 3) metres, face: their line turned by 90 degrees."""
    across = right - left
    return np.arctan2(across[..., 2], -across[..., 0])


def continued(rig: RigLayout, rows: Float32Array, before: Float32Array) -> Float32Array:
    """Rows (T, row_width) with the signs of their quaternions such that they go on from those of a row (row_width).

    q and -q are one rotation; who interpolates the numbers needs neighbours to be near. Within the rows each joint is
    of one sign already, so that it is turned in all of them or in none.
    """
    start = 0
    for block in rig.blocks:
        if block.name == ROTATION_BLOCK:
            break
        start += block.width
    columns = slice(start, start + 4 * len(rig.joint_names))
    first, last = rows[0, columns].reshape(-1, 4), before[columns].reshape(-1, 4)
    signs = np.where((first * last).sum(axis=-1) < 0, np.float32(-1), np.float32(1))
    if (signs > 0).all():
        return rows
    turned = rows.copy()
    turned[:, columns] *= np.repeat(signs, 4)
    return turned
