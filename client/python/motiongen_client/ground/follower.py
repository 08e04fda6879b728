"""GroundFollower: the frames that a session plays, on the ground, each from what is held before and after it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motiongen_client.ground.ground import Ground
from motiongen_client.motion import ROOT_BLOCK, ROTATION_BLOCK, Float32, Frame, Motion
from motiongen_client.playback import Playback
from motiongen_client.sampling import inverse, product, slerp

AROUND_FRAMES = 24
"""Frames that are looked at before and after one: more than a step takes."""
RUN_FRAMES = 8
_FADE_FRAMES = 4


class GroundFollower:
    """Gives each frame of a session's playback on the ground, one after another.

    A step is known by where it ends, as far as that is held. Where a replan moves that while the foot is in the air,
    what is shown goes over to the new way within a fifth of a second.
    """

    def __init__(self, ground: Ground, playback: Playback) -> None:
        self._ground = ground
        self._playback = playback
        self._rows: list[Float32] = []  # what the run was made of, from _first on
        self._run: Float32 | None = None
        self._first = 0
        self._shown: tuple[int, Float32] | None = None
        self._gap: tuple[int, Float32, Float32] | None = (
            None  # frame of the change, and what was shown less what is due
        )

    def frame(self, frame: Frame) -> Frame:
        """The frame on the ground, without outputs. frame: as `poll` or `frames` of the session gave it."""
        index, row = frame.index, frame.row
        place = index - self._first
        if self._run is None or not 0 <= place < len(self._rows) or self._rows[place] is not row:
            self._make(index, row)
            place = index - self._first
        assert self._run is not None
        shown = self._faded(index, self._run[place])
        self._shown = index, shown
        return replace(frame, rig=self._ground.rig.with_outputs({}), row=shown, poser=None)

    def _make(self, index: int, row: Float32) -> None:
        playback = self._playback
        first = max(index - AROUND_FRAMES, playback.first_kept)
        rows = playback.held_rows(first, index + AROUND_FRAMES + RUN_FRAMES)
        if index - first >= len(rows) or rows[index - first] is not row:
            first, rows = index, [row]
        whole = self._ground.apply(Motion(self._ground.rig, first, np.stack(rows))).rows
        last = index + RUN_FRAMES
        if self._shown is not None and first <= self._shown[0] == index - 1:
            self._gap = (index, *self._apart(self._shown[1], whole[index - 1 - first]))
        self._rows, self._run, self._first = (
            rows[index - first : last - first],
            whole[index - first : last - first],
            index,
        )

    def _apart(self, shown: Float32, due: Float32) -> tuple[Float32, Float32]:
        columns = self._ground.rig.block_columns
        root, joints = columns[ROOT_BLOCK], columns[ROTATION_BLOCK]
        return shown[root] - due[root], product(shown[joints].reshape(-1, 4), inverse(due[joints].reshape(-1, 4)))

    def _faded(self, index: int, due: Float32) -> Float32:
        if self._gap is None or index - self._gap[0] >= _FADE_FRAMES:
            return due
        began, off_m, turned = self._gap
        left = 1 - (index - began + 1) / (_FADE_FRAMES + 1)
        weight = left * left * (3 - 2 * left)
        columns = self._ground.rig.block_columns
        root, joints = columns[ROOT_BLOCK], columns[ROTATION_BLOCK]
        row = due.copy()
        row[root] += weight * off_m
        still = np.broadcast_to(np.array([1, 0, 0, 0], np.float32), turned.shape)
        row[joints] = product(slerp(still, turned, weight), due[joints].reshape(-1, 4)).ravel()
        return row
