"""DriftGuard and DriftState: whether a character's posture is sound, and how to correct it if it is not.

A model that continues its own motion for minutes may lean further and further, sink, or fly off. A shorter history lets
it forget a lean; a character that is lost altogether starts afresh where it was. A character also counts as lost if it
was led faster than it can step: it floats behind its root, and keeps doing so when led slowly, as that is its history.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.pose import PoseReader
from motiongen_server.engine.types import Float32Array, StartPose

WORLD_MARGIN = 2.0
"""A character sent to the largest coordinates may walk on beyond them; at this multiple of them it has flown off."""


class Correction(IntEnum):
    """SHORT_HISTORY: the next window sees one patch of history. FRESH_START: it sees none, and is made at once."""

    SHORT_HISTORY = 1
    FRESH_START = 2


@dataclass(frozen=True, slots=True)
class DriftGuard:
    """Judges the rows of a window; shared by all sessions of a rig and a configuration.

    longest_flight: frames without a foot on the ground after which a character counts as lost; 0: no limit.
    """

    reader: PoseReader
    config: EngineConfig
    longest_flight: int = 0

    def correction(self, rows: Float32Array) -> Correction | None:
        """The correction that a window's rows call for. Lean is averaged, so that bending down is no drift."""
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
        """The first of the rows from which on the character floats; None if it does not for long enough."""
        if not (self.config.guard_drift and self.longest_flight):
            return None
        return self.reader.flight(rows, self.longest_flight)

    def fresh_start(self, row: Float32Array) -> StartPose:
        """The start pose of a fresh start: where this row is, or as near as coordinates allow."""
        limit = WORLD_MARGIN * self.config.max_coordinate_m
        x, _, z = np.clip(self.reader.positions(row[None])[0], -limit, limit)
        return StartPose(float(x), float(z), self.reader.heading(row))


@dataclass(slots=True)
class DriftState:
    """The soundness of one character. correction: what its next window must correct; lost_from: where that began.

    tried: whether the window judged last was itself to correct something.
    """

    guard: DriftGuard
    correction: Correction | None = None
    lost_from: int = 0
    tried: bool = False

    @property
    def lost(self) -> bool:
        """Whether the character must be corrected at once."""
        return self.correction is Correction.FRESH_START

    def judge(self, rows: Float32Array, first_frame: int, before: Float32Array, *, again: bool = False) -> None:
        """Judge the rows of a window that has landed, from first_frame on.

        before: the rows before it, as many as a character may float. again: the window was to correct earlier ones.
        """
        self.correction, self.lost_from, self.tried = self.guard.correction(rows), first_frame, again
        if self.correction is not Correction.FRESH_START:
            floats_from = self.guard.flight(np.concatenate((before, rows)))
            if floats_from is not None:
                self.correction, self.lost_from = Correction.FRESH_START, first_frame - len(before) + floats_from

    def correction_from(self, first_frame: int) -> Correction | None:
        """What a window from first_frame on must correct; before the frame where it was lost, a character is sound."""
        return Correction.SHORT_HISTORY if self.lost and first_frame <= self.lost_from else self.correction
