"""PlaybackClock: when frames are due, at a pace that may change, and for how long the last one is held. Pure."""

from __future__ import annotations

import math

from motiongen_client.types import check_number

# Frame times are inexact in binary, so frames count as due slightly early: one for 0.15 s already at 0.1499999 s.
_EARLY_FRAMES = 1e-6


class PlaybackClock:
    """The clock of one playback.

    due_s: when the frame after the playhead is due; None: the clock starts anew, from the pose being shown. underruns:
    frame times for which the last frame was held.
    """

    def __init__(self, frame_rate_hz: float) -> None:
        self.due_s: float | None = None
        self.underruns = 0
        self._frame_rate_hz = frame_rate_hz
        self._pace_hz = self._next_pace_hz = float(frame_rate_hz)
        self._share = 0.0
        self._held_since_s: float | None = None
        self._held_frames = 0

    def set_scale(self, scale: float) -> None:
        """Run at another pace from the next `count_due` on. Raises InvalidInput if it is not positive and finite."""
        rate_hz = self._frame_rate_hz

        def is_allowed(scale: float) -> bool:
            pace_hz = rate_hz * float(scale)
            return 0 < pace_hz < math.inf and 1 / pace_hz < math.inf  # a frame time must be finite too

        check_number("scale", scale, "a number above 0; pause to stand still", is_allowed)
        self._next_pace_hz = rate_hz * float(scale)

    def begin(self, now_s: float) -> None:
        """The first frame is shown now."""
        self._pace_hz = self._next_pace_hz
        self.due_s = now_s + 1 / self._pace_hz

    def stop(self) -> None:
        """Start anew with the next `count_due`."""
        self.due_s = self._held_since_s = None

    def jump(self) -> None:
        """As `stop`, at the beginning of a frame."""
        self.stop()
        self._share = 0.0

    def count_due(self, now_s: float, num_left: int) -> int:
        """How many frames have become due, of those that are left to show. Holds if there are too few."""
        if self.due_s is None:
            self.due_s = now_s + (1 - self._share) / self._pace_hz
        if self._held_since_s is not None and num_left > 0:
            self._count_held(math.ceil((now_s - self._held_since_s) * self._pace_hz - _EARLY_FRAMES))
            self._held_since_s = None
            self.due_s = now_s
        num_due = math.floor(max((now_s - self.due_s) * self._pace_hz + _EARLY_FRAMES, -1.0)) + 1
        num_shown = min(num_due, num_left)
        if num_shown:
            self._share = 0.0
        self.due_s += num_shown / self._pace_hz
        if num_due > num_left:
            if self._held_since_s is None:
                self._held_since_s = self.due_s
                self._held_frames = 0
            self._count_held(math.floor((now_s - self._held_since_s) * self._pace_hz + _EARLY_FRAMES) + 1)
        self._take_next_pace(now_s)
        return num_shown

    def share(self, now_s: float) -> float:
        """The elapsed share of the time from the playhead to the next frame, 0 to 1."""
        is_running = self.due_s is not None and self._held_since_s is None
        left = (self.due_s - now_s) * self._pace_hz if is_running and self.due_s is not None else 1.0
        self._share = min(max(1.0 - left, 0.0), 1.0)
        return self._share

    @property
    def last_share(self) -> float:
        """What `share` returned last, or 0 if a frame has become due since."""
        return self._share

    def _take_next_pace(self, now_s: float) -> None:
        """Run at the pace set last. What is over of a frame time counts, or setting it all the time would stop it."""
        pace_hz, self._pace_hz = self._pace_hz, self._next_pace_hz
        if pace_hz == self._pace_hz:
            return
        if self.due_s is not None:
            self.due_s = now_s + (self.due_s - now_s) * pace_hz / self._pace_hz
        if self._held_since_s is not None:
            self._held_since_s = now_s + (self._held_since_s - now_s) * pace_hz / self._pace_hz

    def _count_held(self, held_frames: int) -> None:
        """Raise the count of the present hold to `held_frames` frame times."""
        self.underruns += max(held_frames - self._held_frames, 0)
        self._held_frames = max(held_frames, self._held_frames)
