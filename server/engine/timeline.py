"""Timeline: the frames a session holds, and PlaybackClock: which of them the client is showing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from server.engine.types import Float32Array, PlayState


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """Consecutive frames from `first` on; a new value for every change, so that views of an old one stay true.

    rows: (T, row_width) float32, for the wire. features: (T, D) float32, normalized, for histories.
    """

    first: int
    rows: Float32Array
    features: Float32Array

    @classmethod
    def empty(cls, row_width: int, feature_dim: int) -> Timeline:
        return cls(0, np.empty((0, row_width), np.float32), np.empty((0, feature_dim), np.float32))

    @property
    def end(self) -> int:
        """The first frame that is not held."""
        return self.first + len(self.rows)

    def spliced(self, frame: int, rows: Float32Array, features: Float32Array) -> Timeline:
        """Keep the frames below `frame`, which is held or is the end, and put new ones after them."""
        keep = frame - self.first
        return Timeline(
            self.first,
            np.concatenate((self.rows[:keep], rows)),
            np.concatenate((self.features[:keep], features)),
        )

    def trimmed(self, frame: int) -> Timeline:
        """Drop the frames below `frame`, and their memory."""
        drop = max(0, frame - self.first)
        return Timeline(self.first + drop, self.rows[drop:].copy(), self.features[drop:].copy())

    def rows_between(self, begin: int, end: int) -> Float32Array:
        return self.rows[begin - self.first : end - self.first]

    def features_before(self, frame: int, num_frames: int) -> Float32Array:
        """The features of the num_frames frames that end just before `frame`."""
        stop = frame - self.first
        return self.features[stop - num_frames : stop]


@dataclass(slots=True)
class PlaybackClock:
    """The client's playhead between its reports.

    Until the first report the client stands at frame 0, not yet playing. From then on the playhead moves at fps from
    the newest report, up to what was sent and no further, unless paused. `reported` is the newest report: the credit is
    counted from it, not from the estimate, so that a silent client gets a lookahead of frames and no more.
    """

    fps: int
    state: PlayState = PlayState.PLAYING
    started: bool = False
    reported: int = 0
    anchor_frame: float = 0.0
    anchor_at: float = 0.0

    @property
    def running(self) -> bool:
        return self.started and self.state is PlayState.PLAYING

    def unheld(self, now: float) -> float:
        """Where the playhead would be had no frame ever been missing."""
        if not self.running:
            return self.anchor_frame
        return self.anchor_frame + max(0.0, now - self.anchor_at) * self.fps

    def estimate(self, now: float, sent_to: int) -> float:
        """The frame shown now, fractional; at most sent_to, where the client waits for more."""
        return min(self.unheld(now), float(sent_to))

    def reaches_at(self, frame: float) -> float:
        """When the playhead reaches a frame; infinity if it stands."""
        return self.anchor_at + (frame - self.anchor_frame) / self.fps if self.running else math.inf

    def report(self, frame: int, at: float, sent_to: int) -> None:
        """Take a report. A frame beyond what was sent is taken as sent_to; one below an earlier report is ignored."""
        if frame < self.reported:
            return
        self.reported = min(frame, sent_to)
        self.anchor_frame = float(self.reported)
        self.anchor_at = at
        self.started = True

    def set_state(self, state: PlayState, at: float, sent_to: int) -> None:
        self.anchor_frame = self.estimate(at, sent_to)
        self.anchor_at = at
        self.state = state

    def resume_from(self, sent_to: int, now: float) -> None:
        """Before more is sent: a client that had run out plays on from where it waited, not from where it would be."""
        if self.unheld(now) > sent_to:
            self.anchor_frame = float(sent_to)
            self.anchor_at = now
