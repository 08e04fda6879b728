"""PlaybackClock: which frame the client is showing; RoundTrip: how long a message takes to the client and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

from motiongen_server.engine.types import PlayState

# After this time a measured round trip counts half; none is believed to be longer than a second.
_HALF_LIFE_S = 10.0
_LONGEST_S = 1.0
PACE = 1.05
"""Playback slightly faster than the frame rate is no jump: reports come unevenly, and clocks differ."""
START_FRAMES = 10
"""A first report may be this many frames late, which is half a second's worth."""


@dataclass(slots=True)
class RoundTrip:
    """The longest round trip of late: a longer measurement counts at once, and then decays slowly.

    seconds: initially the assumed round trip.
    """

    seconds: float
    measured_at: float = -math.inf

    def report(self, measured_s: float | None, at: float) -> None:
        """Take a measurement; None and NaN are ignored."""
        if measured_s is None or math.isnan(measured_s):
            return
        measured_s = min(max(measured_s, 0.0), _LONGEST_S)
        fallen_s = self.seconds * 0.5 ** (max(0.0, at - self.measured_at) / _HALF_LIFE_S)
        self.seconds = max(measured_s, fallen_s)
        self.measured_at = max(at, self.measured_at)


@dataclass(slots=True)
class PlaybackClock:
    """The client's playhead between its reports.

    Until the first report the client is at frame 0, not yet playing. From then on the playhead moves at fps from the
    newest report, up to what was sent, unless paused.

    A client's reports may be false, so three values are kept apart. `reported` is its newest report; no frame before it
    is replaced. `credited` is how far a client can have come that plays at `rate` times the frame rate, and may get
    ahead of that by `slack` frames once. Frames are sent up to a lookahead from there, not from the estimate, so that a
    client that is silent or jumps ahead gets a lookahead of frames and no more. `paced` is where the playhead would be
    without jumps, and standing while paused: deadlines count from there, because the machine is not late if a jump
    makes frames late.
    """

    fps: int
    state: PlayState = PlayState.PLAYING
    rate: float = 1.05
    slack: float = math.inf
    started: bool = False
    reported: int = 0
    credited: int = 0
    anchor_frame: float = 0.0
    anchor_at: float = 0.0
    _allowance: float = math.inf  # frames by which `credited` may rise at once, as of _paced_at
    _paced_frame: float = 0.0
    _paced_at: float = 0.0

    @property
    def running(self) -> bool:
        return self.started and self.state is PlayState.PLAYING

    def unheld(self, now: float) -> float:
        """Where the playhead would be if no frame had ever been missing."""
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
        """Take a report. A frame beyond what was sent counts as sent_to; one below an earlier report is ignored.

        No client can show a frame that was never sent: it waits at the end of what it has, and the motion continues
        from there without a gap.
        """
        if frame < self.reported:
            return
        frame = min(frame, sent_to)
        if self.started:
            self._keep_pace(float(frame), at)
        else:
            self._paced_frame, self._allowance = float(min(frame, START_FRAMES)), self.slack
            self._paced_at = max(at, self._paced_at)
        step = min(max(0, frame - self.credited), math.floor(min(self._allowance, frame)))
        self._allowance -= step
        self.credited += step
        self.reported = frame
        self.anchor_frame = float(frame)
        self.anchor_at = at
        self.started = True

    def paced(self, now: float, sent_to: int) -> float:
        """The frame shown now by a client that has not jumped ahead, fractional."""
        return min(self.estimate(now, sent_to), self._paced_to(now))

    def _paced_to(self, now: float) -> float:
        if self.state is not PlayState.PLAYING:
            return self._paced_frame
        return self._paced_frame + max(0.0, now - self._paced_at) * self.fps * PACE

    def _keep_pace(self, frame: float, at: float) -> None:
        """Continue pace and allowance from here. frame: the one shown, or believed to be."""
        self._paced_frame = min(self._paced_to(at), frame)
        self._allowance = min(self.slack, self._allowance + max(0.0, at - self._paced_at) * self.fps * self.rate)
        self._paced_at = max(at, self._paced_at)

    def go_on(self, frame: int, at: float) -> None:
        """The client of a session from another engine shows this frame, by its own report."""
        self.reported = self.credited = frame
        self.anchor_frame = self._paced_frame = float(frame)
        self.anchor_at = self._paced_at = at
        self._allowance = self.slack
        self.started = True

    def set_state(self, state: PlayState, at: float, sent_to: int) -> None:
        """The client plays or pauses from now on. While paused, it earns no frames."""
        frame = self.estimate(at, sent_to)
        if self.started:
            self._keep_pace(frame, at)
        self.anchor_frame, self.anchor_at = frame, at
        self.state = state

    def resume_from(self, sent_to: int, now: float) -> None:
        """Called before more is sent: a client that had run out continues from where it waited."""
        if self.unheld(now) > sent_to:
            self.anchor_frame = float(sent_to)
            self.anchor_at = now
