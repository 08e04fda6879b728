"""GroundFollower: puts the frames of a session on the ground, using the frames held before and after each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motiongen_client.ground.ground import Ground
from motiongen_client.motion import ROOT_BLOCK, ROTATION_BLOCK, Float32, Frame, Motion
from motiongen_client.playback import Playback
from motiongen_client.sampling import inverse, product, slerp

AROUND_FRAMES = 24
"""Frames considered before and after each: more than a step takes."""
RUN_FRAMES = 8
_FADE_FRAMES = 4


class GroundFollower:
    """Puts consecutive frames of a session's playback on the ground, and poses between them.

    A foot in the air moves towards where it will stand, as far as those frames are held. If a replan changes that place
    in mid-step, the shown pose blends over to the new one within a fifth of a second.
    """

    def __init__(self, ground: Ground, playback: Playback) -> None:
        self._ground = ground
        self._playback = playback
        self._rig = ground.rig.with_outputs({})
        self._rows: list[Float32] = []  # the level rows of the run, from _first on; one more than is used
        self._run: Float32 | None = None
        self._first = 0
        self._shown: tuple[int, Float32] | None = None
        self._gap: tuple[int, Float32, Float32] | None = (
            None  # frame of the change; the shown pose relative to the one due
        )

    def frame(self, frame: Frame) -> Frame:
        """The frame on the ground, without outputs. frame: from the session's `poll`, `frames` or `sample`."""
        index = frame.index
        held = self._playback.held_rows(index, index + 1)
        level = held[0] if held else frame.row
        place = index - self._first
        if self._run is None or place >= RUN_FRAMES or not self._is_of_run(index, level):
            self._make(index, level)
            place = 0
        assert self._run is not None
        shown = self._faded(index, self._run[place])
        self._shown = index, shown
        row = shown if frame.row is level else self._between(frame, level, shown)
        return replace(frame, rig=self._rig, row=row, poser=None)

    def _is_of_run(self, index: int, row: Float32) -> bool:
        place = index - self._first
        return 0 <= place < len(self._rows) and self._rows[place] is row

    def _make(self, index: int, row: Float32) -> None:
        first, rows = self._around(index)
        if index - first >= len(rows) or rows[index - first] is not row:
            first, rows = index, [row]
        whole = self._ground.apply(Motion(self._ground.rig, first, np.stack(rows))).rows
        self._gap = None
        if self._shown is not None and first <= self._shown[0] == index - 1:
            self._gap = (index, *self._apart(self._shown[1], whole[index - 1 - first]))
        run = slice(index - first, index - first + RUN_FRAMES + 1)
        self._rows, self._run, self._first = rows[run], whole[run], index

    def _around(self, index: int) -> tuple[int, list[Float32]]:
        """The index of the first frame around one, and the rows from there on; none beyond a cut."""
        playback = self._playback
        first = index
        while first > max(index - AROUND_FRAMES, playback.first_kept) and not playback.is_cut(first):
            first -= 1
        rows = playback.held_rows(first, index + AROUND_FRAMES + RUN_FRAMES)
        ahead = range(index + 1, first + len(rows))
        end = next((frame for frame in ahead if playback.is_cut(frame)), ahead.stop)
        return first, rows[: end - first]

    def _between(self, frame: Frame, level: Float32, shown: Float32) -> Float32:
        """A row between two frames, with the ground's changes to both frames interpolated and applied to it."""
        joints = self._ground.leg_columns
        height = self._ground.rig.block_columns[ROOT_BLOCK].start + 1
        up, turns = shown[height] - level[height], self._turns(shown, level)
        following = self._playback.held_rows(frame.index + 1, frame.index + 2)
        if frame.share > 0 and following and self._is_of_run(frame.index + 1, following[0]):
            assert self._run is not None
            due = self._faded(frame.index + 1, self._run[frame.index + 1 - self._first])
            up = up + frame.share * (due[height] - following[0][height] - up)
            turns = slerp(turns, self._turns(due, following[0]), frame.share)
        row = frame.row.copy()
        row[height] += up
        row[joints] = product(turns, row[joints])
        return row

    def _turns(self, shown: Float32, level: Float32) -> Float32:
        joints = self._ground.leg_columns
        return product(shown[joints], inverse(level[joints]))

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
