"""PoseReader: what the engine needs to know of frame rows: where the root is and faces, its lean, feet in the air."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.types import Float32Array, RigLayout
from motiongen_server.engine.types.facts import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK


@dataclass(frozen=True, slots=True)
class PoseReader:
    """Reads rows of one rig. root, rotation: the first column of the root's position and of its world quaternion.

    contacts: the columns that say whether feet are on the ground.
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
        """(T, 3) metres: the root of each row; the origin where the rig's rows do not tell."""
        if self.root is None:
            return np.zeros((len(rows), 3), np.float32)
        return rows[:, self.root : self.root + 3]

    def heading(self, row: Float32Array) -> float:
        """Where the root faces, radians about the up axis, 0 toward +Z; 0 where the rig's rows do not tell."""
        if self.rotation is None:
            return 0.0
        w, x, y, z = (float(value) for value in row[self.rotation : self.rotation + 4])
        return math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y))

    def lean(self, rows: Float32Array) -> float:
        """Radians between the vertical and the up axis of the root, whose height is averaged over the rows."""
        if self.rotation is None:
            return 0.0
        x, z = rows[:, self.rotation + 1], rows[:, self.rotation + 3]
        up = 1 - 2 * float(x @ x + z @ z) / len(rows)
        return math.acos(min(max(up, -1.0), 1.0))

    def flight(self, rows: Float32Array, num_frames: int) -> int | None:
        """The first of num_frames or more rows in which no foot is on the ground; None where there are not so many."""
        if self.contacts is None:
            return None
        grounded = np.flatnonzero((rows[:, self.contacts] > 0.5).any(axis=1))
        landings = np.concatenate(([-1], grounded, [len(rows)]))
        long = np.flatnonzero(np.diff(landings) > num_frames)
        return int(landings[long[0]]) + 1 if len(long) else None
