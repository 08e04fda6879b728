"""PlaybackClock: which frame the client is showing; RoundTrip: how long the way to it and back takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from motiongen_server.engine.types import PlayState

# A round trip counts for as long as this before half of it is forgotten; none is believed to be longer than a second.
_HALF_LIFE_S = 10.0
_LONGEST_S = 1.0


@dataclass(slots=True)
class RoundTrip:
    """The longest round trip of late: a measured one counts at once, and from then on slowly falls.

    seconds: what was assumed until the first measurement.
    """

    seconds: float
    measured_at: float = -math.inf

    def report(self, measured_s: float | None, at: float) -> None:
        """Take a measurement; None and what is not a number count as none."""
        if measured_s is None or math.isnan(measured_s):
            return
        measured_s = min(max(measured_s, 0.0), _LONGEST_S)
        fallen_s = self.seconds * 0.5 ** (max(0.0, at - self.measured_at) / _HALF_LIFE_S)
        self.seconds = max(measured_s, fallen_s)
        self.measured_at = max(at, self.measured_at)


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
        if not self.started or self.state is not PlayState.PLAYING or now <= self.anchor_at:
            return self.anchor_frame
        return self.anchor_frame + (now - self.anchor_at) * self.fps

    def estimate(self, now: float, sent_to: int) -> float:
        """The frame shown now, fractional; at most sent_to, where the client waits for more."""
        return min(self.unheld(now), float(sent_to))

    def reaches_at(self, frame: float) -> float:
        """When the playhead reaches a frame; infinity if it stands."""
        return self.anchor_at + (frame - self.anchor_frame) / self.fps if self.running else math.inf

    def report(self, frame: int, at: float, sent_to: int) -> None:
        """Take a report. A frame beyond what was sent is taken as sent_to; one below an earlier report is ignored.

        Nobody can show a frame that was never sent: such a client waits at the end of what it has, and the motion goes
        on from there without a gap.
        """
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
