"""PoseReader: what the engine needs to know of a frame row: where the root is, where it faces, how far it leans."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.types import Float32Array, RigLayout
from motiongen_server.engine.types.facts import ROOT_BLOCK, ROTATION_BLOCK


@dataclass(frozen=True, slots=True)
class PoseReader:
    """Reads rows of one rig. root, rotation: the first column of the root's position and of its world quaternion."""

    root: int | None
    rotation: int | None

    @classmethod
    def of(cls, rig: RigLayout) -> PoseReader:
        columns: dict[str, int] = {}
        width = 0
        for block in rig.blocks:
            columns[block.name] = width
            width += block.width
        return cls(columns.get(ROOT_BLOCK), columns.get(ROTATION_BLOCK))

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
