"""DriftGuard and DriftState: whether a character still stands as one should, and what rights it if it does not.

A model that feeds on its own motion for minutes may come to lean further and further, to sink, or to fly off. A shorter
history lets it forget the lean; one that is lost altogether starts anew where it was. Lost, too, is one that was led
faster than it can step: it floats along behind its root, and does so when it is led slowly again, since that is its
history.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.pose import PoseReader
from motiongen_server.engine.types import Float32Array, StartPose

WORLD_MARGIN = 2.0
"""Who was sent to the edge of where coordinates go may walk on beyond it; only who is twice as far has flown off."""


class Correction(IntEnum):
    """SHORT_HISTORY: the next window sees one patch of history. FRESH_START: none, and is made at once."""

    SHORT_HISTORY = 1
    FRESH_START = 2


@dataclass(frozen=True, slots=True)
class DriftGuard:
    """Judges the rows of a window; shared by all sessions of a rig and a configuration.

    longest_flight: frames without a foot on the ground after which a character is lost; 0: it may fly for ever.
    """

    reader: PoseReader
    config: EngineConfig
    longest_flight: int = 0

    def correction(self, rows: Float32Array) -> Correction | None:
        """What the rows of a window call for. A lean counts on average, so that bending down is no drift."""
        if not self.config.guard_drift:
            return None
        config, positions = self.config, self.reader.positions(rows)
        if self.reader.root is not None:
            low, high = float(positions[:, 1].min()), float(positions[:, 1].max())
            far = float(np.abs(positions).max())
            sound = config.min_root_height_m <= low and high <= config.max_root_height_m
            if not (sound and far <= WORLD_MARGIN * config.max_coordinate_m):
                return Correction.FRESH_START
        if self.reader.lean(rows) > config.max_lean_rad:
            return Correction.SHORT_HISTORY
        return None

    def flight(self, rows: Float32Array) -> int | None:
        """The first of the rows from which on it floats; None where it does not for long."""
        if not (self.config.guard_drift and self.longest_flight):
            return None
        return self.reader.flight(rows, self.longest_flight)

    def fresh_start(self, row: Float32Array) -> StartPose:
        """Where a character that shows this row starts anew: there, or as near as coordinates go."""
        limit = WORLD_MARGIN * self.config.max_coordinate_m
        x, _, z = np.clip(self.reader.positions(row[None])[0], -limit, limit)
        return StartPose(float(x), float(z), self.reader.heading(row))


@dataclass(slots=True)
class DriftState:
    """How one character stands. correction: what its next window is to put right, in one that began at lost_from.

    tried: whether that one was to put something right already.
    """

    guard: DriftGuard
    correction: Correction | None = None
    lost_from: int = 0
    tried: bool = False

    @property
    def lost(self) -> bool:
        """Whether it must be righted at once."""
        return self.correction is Correction.FRESH_START

    def judge(self, rows: Float32Array, first_frame: int, before: Float32Array, *, again: bool = False) -> None:
        """Look at the rows of a window that has landed, from first_frame on. before: up to as many as one may float.

        again: the window was to right what those before it did.
        """
        self.correction, self.lost_from, self.tried = self.guard.correction(rows), first_frame, again
        if self.correction is not Correction.FRESH_START:
            floats_from = self.guard.flight(np.concatenate((before, rows)))
            if floats_from is not None:
                self.correction, self.lost_from = Correction.FRESH_START, first_frame - len(before) + floats_from

    def correction_from(self, first_frame: int) -> Correction | None:
        """What a window from first_frame on needs: before the frames where it was lost the character is sound."""
        return Correction.SHORT_HISTORY if self.lost and first_frame <= self.lost_from else self.correction
