"""PoseReader: what the engine reads from frame rows: the root's position and heading, its lean, feet in the air."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.types import Float32Array, RigLayout
from motiongen_server.engine.types.facts import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK


@dataclass(frozen=True, slots=True)
class PoseReader:
    """Reads rows of one rig. root, rotation: the first column of the root's position and of its world quaternion.

    contacts: the columns that tell whether feet are on the ground.
    """

    root: int | None
    rotation: int | None
    contacts: slice | None = None

    @classmethod
    def of(cls, rig: RigLayout) -> PoseReader:
        columns: dict[str, slice] = {}
        width = 0
        for block in rig.blocks:
            columns[block.name] = slice(width, width + block.width)
            width += block.width
        first = {name: block.start for name, block in columns.items()}
        return cls(first.get(ROOT_BLOCK), first.get(ROTATION_BLOCK), columns.get(CONTACT_BLOCK))

    def positions(self, rows: Float32Array) -> Float32Array:
        """(T, 3) metres: the root in each row; the origin if the rig's rows have no root position."""
        if self.root is None:
            return np.zeros((len(rows), 3), np.float32)
        return rows[:, self.root : self.root + 3]

    def heading(self, row: Float32Array) -> float:
        """The root's heading, radians about the up axis, 0 toward +Z; 0 if the rig's rows have no rotations."""
        if self.rotation is None:
            return 0.0
        w, x, y, z = (float(value) for value in row[self.rotation : self.rotation + 4])
        return math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y))

    def lean(self, rows: Float32Array) -> float:
        """Radians between the vertical and the root's up axis, of which the vertical part is averaged over the rows."""
        if self.rotation is None:
            return 0.0
        x, z = rows[:, self.rotation + 1], rows[:, self.rotation + 3]
        up = 1 - 2 * float(x @ x + z @ z) / len(rows)
        return math.acos(min(max(up, -1.0), 1.0))

    def flight(self, rows: Float32Array, num_frames: int) -> int | None:
        """The first of at least num_frames rows in which no foot is on the ground; None if there are not that many."""
        if self.contacts is None:
            return None
        grounded = np.flatnonzero((rows[:, self.contacts] > 0.5).any(axis=1))
        landings = np.concatenate(([-1], grounded, [len(rows)]))
        long = np.flatnonzero(np.diff(landings) > num_frames)
        return int(landings[long[0]]) + 1 if len(long) else None
