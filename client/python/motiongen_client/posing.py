"""Poser: joint positions of the frames that a session plays, computed for several frames at once."""

from __future__ import annotations

import numpy as np

from motiongen_client.motion import Float32, Motion, Rig
from motiongen_client.playback import Playback

RUN_FRAMES = 16
"""Frames computed at once: one alone costs as much as ten."""


class Poser:
    """Keeps the positions of the last run. A frame that a replan has replaced since is computed alone."""

    def __init__(self, rig: Rig, playback: Playback) -> None:
        self._rig = rig
        self._playback = playback
        self._first = 0
        self._rows: list[Float32] = []
        self._positions: Float32 | None = None

    def positions_m(self, index: int, row: Float32) -> Float32:
        """(J, 3) world positions of all joints, given a frame's index and row."""
        place = index - self._first
        if self._positions is None or not 0 <= place < len(self._rows) or self._rows[place] is not row:
            rows = self._playback.held_rows(index, index + RUN_FRAMES)
            if not rows or rows[0] is not row:
                alone: Float32 = Motion(self._rig, index, row[None]).joint_positions_m()[0]
                return alone
            run = Motion(self._rig, index, np.stack(rows))
            self._first, self._rows, place = index, rows, 0
            self._positions = run.joint_positions_m()
        positions: Float32 = self._positions[place].copy()
        return positions
