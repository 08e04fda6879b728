"""Playback: received frames by index, the playhead, and what a replan replaces. Pure: no network, no clock.

This file applies these rules of the protocol:

- a plan notice drops every buffered frame from `valid_from` on; the plan's chunks supply them again, without a gap;
- frames below `committed_to` never change, and `committed_to` never falls;
- a frame that was shown stays as it was shown. If a plan nevertheless begins behind the playhead, its frames up to the
  playhead are ignored, and `late_plans` counts it;
- while the next frame is missing, the last one is held, and `underruns` counts each frame time for which it is held.

Callers pass the time as `now_s`, in seconds of any monotonic clock.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput, ProtocolViolation
from motiongen_client.playback_clock import PlaybackClock
from motiongen_client.types import check_frame, check_number, check_whole

Rows = NDArray[np.float32]

MOST_AHEAD_BYTES = 2**28
"""Limit on frames ahead of the playhead, far above any credit."""
MOST_CUTS_AHEAD = 64
"""Limit on announced cuts whose frames have not arrived."""


class Playback:
    """The frames of one session, from the first one kept to the last one received.

    keep_frames: how many frames behind the playhead stay readable, beside those that `advance` has just reached; None
    keeps all of them.
    plan, plan_from: the latest plan's number and first frame.
    """

    def __init__(
        self, frame_rate_hz: float, row_width: int, *, start_frame: int = 0, keep_frames: int | None = None
    ) -> None:
        check_number("frame_rate_hz", frame_rate_hz, "a number above 0", lambda each: 0 < each < math.inf)
        check_whole("row_width", row_width, "a whole number of 1 or more", least=1)
        check_frame("start_frame", start_frame)
        if keep_frames is not None:
            allowed = "a whole number of 0 or more, or None to keep all frames"
            check_number("keep_frames", keep_frames, allowed, lambda each: each >= 0)
        self.frame_rate_hz = frame_rate_hz
        self.row_width = row_width
        self.playhead = start_frame
        self.committed_to = start_frame
        self.plan = 0
        self.plan_from = start_frame
        self.late_plans = 0
        self._clock = PlaybackClock(frame_rate_hz)
        self._keep_frames = keep_frames
        self._rows: list[Rows] = []
        self._first_kept = start_frame
        self._received_to = start_frame  # where the next chunk must begin; below buffered_to only after a late plan
        self._cuts: list[int] = []  # ascending
        self._passed = range(0)  # frames that the latest late plan should have replaced, but that were shown
        self._started = False
        self._playing = True

    @property
    def started(self) -> bool:
        """Whether a frame has been shown; until then the playhead is the first frame to show."""
        return self._started

    @property
    def is_playing(self) -> bool:
        """Whether the playhead advances, or would if frames were available."""
        return self._playing

    @property
    def underruns(self) -> int:
        """Frame times for which the last frame was held."""
        return self._clock.underruns

    @property
    def buffered_to(self) -> int:
        """The frame after the last one held."""
        return self._first_kept + len(self._rows)

    @property
    def first_kept(self) -> int:
        """The oldest frame that can still be read."""
        return self._first_kept

    def announce_plan(self, plan: int, valid_from: int, *, is_cut: bool = False) -> int:
        """Take a plan notice: drop the frames it replaces. Returns how many were dropped.

        is_cut: its first frame does not continue the one before. If that was shown already, the next one does not.

        Raises ProtocolViolation if the plan is not newer, would replace committed frames, or is one cut too many.
        """
        if plan <= self.plan:
            raise ProtocolViolation(f"plan {plan} was announced after plan {self.plan}; plans must rise")
        if valid_from < self.committed_to:
            raise ProtocolViolation(
                f"plan {plan} replaces frames from {valid_from}, but frames below {self.committed_to} are committed"
            )
        first_replaceable = max(valid_from, self.playhead + 1) if self._started else valid_from
        replaced = bisect_left(self._cuts, first_replaceable)
        if is_cut and replaced - bisect_right(self._cuts, self._received_to, hi=replaced) >= MOST_CUTS_AHEAD:
            raise ProtocolViolation(f"more than {MOST_CUTS_AHEAD} cuts were announced before their frames")
        self.plan, self.plan_from = plan, valid_from
        del self._cuts[replaced:]
        # the newest cut behind the frames kept stays: a sampler may not have shown a frame since
        del self._cuts[: max(bisect_right(self._cuts, self._first_kept) - 1, 0)]
        if first_replaceable > valid_from:
            self._passed = range(valid_from, first_replaceable)
        if is_cut:
            self._cuts.append(first_replaceable)
        if valid_from > self._received_to:
            return 0  # frames before valid_from that are still to come will carry this plan's number
        self._received_to = valid_from
        if valid_from < first_replaceable:
            self.late_plans += 1
        dropped = max(self.buffered_to - first_replaceable, 0)
        del self._rows[len(self._rows) - dropped :]
        return dropped

    def note_cut(self, frame: int) -> int:
        """Record a requested cut at a frame: if the session was away when it was made, no plan notice tells of it.

        Returns the frame at which it shows: the first that can be replaced, if its own was shown before it was known.
        """
        shows_at = self._passed.stop if frame in self._passed else frame
        if not self.is_cut(shows_at):
            self._cuts.insert(bisect_left(self._cuts, shows_at), shows_at)
        return shows_at

    def is_cut(self, frame: int) -> bool:
        """Whether a frame does not continue the one before it, so that nothing may be blended there."""
        place = bisect_left(self._cuts, frame)
        return place < len(self._cuts) and self._cuts[place] == frame

    def cut_before(self, frame: int) -> int | None:
        """The last cut before a frame; None if there is none, or it is no longer kept."""
        place = bisect_left(self._cuts, frame)
        return self._cuts[place - 1] if place else None

    @property
    def received_to(self) -> int:
        """The frame at which the next chunk must begin."""
        return self._received_to

    def restart(self, frame: int) -> None:
        """Prepare for a session opened anew, which continues at `frame` (`buffered_to`) and numbers plans from 1."""
        self.plan = 0
        self.plan_from = self._received_to = self.committed_to = frame

    def add_chunk(self, plan: int, first_frame: int, rows: Rows, committed_to: int) -> None:
        """Take consecutive frames. rows: (T, D) float32, row 0 being frame `first_frame`.

        Raises ProtocolViolation if they do not belong to the latest plan, come before any, do not continue the frames
        received so far, have another width, lower committed_to, or are more than are held ahead of the playhead.
        """
        if plan != self.plan:
            raise ProtocolViolation(f"a chunk of plan {plan} arrived, but the latest plan is {self.plan}")
        if plan == 0:  # they are numbered from 1
            raise ProtocolViolation("a chunk arrived before any plan was announced")
        if first_frame != self._received_to:
            raise ProtocolViolation(f"a chunk begins at frame {first_frame}; the next frame is {self._received_to}")
        if rows.ndim != 2 or rows.shape[1] != self.row_width:
            raise ProtocolViolation(f"a chunk has shape {rows.shape}; rows of {self.row_width} numbers were announced")
        if committed_to < self.committed_to:
            raise ProtocolViolation(f"committed_to fell from {self.committed_to} to {committed_to}")
        most = MOST_AHEAD_BYTES // (4 * self.row_width)
        if first_frame + len(rows) - self.playhead > most:
            raise ProtocolViolation(
                f"frame {first_frame + len(rows) - 1} came while {self.playhead} is played; at most {most} frames are "
                "held ahead"
            )
        self.committed_to = committed_to
        already_shown = self.buffered_to - first_frame
        self._rows.extend(rows[already_shown:])
        self._received_to = first_frame + len(rows)

    def advance(self, now_s: float) -> range:
        """Move the playhead to the frame due now, as far as frames are available. Returns the frames newly reached.

        The first call that finds a frame shows it and starts the clock. After a hold, the next frame is shown at once
        and later ones one frame time apart: nothing is skipped.
        """
        if not self._playing or (not self._started and not self._rows):
            return range(0)
        if not self._started:
            self._clock.begin(now_s)
            return self._start(self.playhead)
        reached = self._move(self._clock.count_due(now_s, self.buffered_to - 1 - self.playhead))
        self._forget(reached.start)
        return reached

    def advance_to(self, frame: int) -> range:
        """Move the playhead to `frame` whatever the time, for callers that consume faster or slower than real time.

        Returns the frames newly reached. Raises InvalidInput if `frame` is behind the playhead or not available yet.
        """
        if not self.playhead <= frame < self.buffered_to:
            raise InvalidInput("frame", frame, f"a frame from {self.playhead} to {self.buffered_to - 1}")
        reached = self._move(frame - self.playhead) if self._started else self._start(frame)
        self._forget(frame)
        self._clock.jump()
        return reached

    def pause(self) -> None:
        """Stop the playhead until `resume`."""
        self._playing = False

    def resume(self) -> None:
        """Let the playhead continue: the clock restarts at the next `advance`, from the pose being shown."""
        self._playing = True
        self._clock.stop()

    def set_time_scale(self, scale: float) -> None:
        """Play at another pace from the next `advance` on: 0.5 is half as fast. Raises InvalidInput if not positive."""
        self._clock.set_scale(scale)

    def share(self, now_s: float) -> float:
        """The elapsed share of the time from the playhead to the next frame, 0 to 1; constant while paused."""
        return self._clock.share(now_s) if self._playing else self._clock.last_share

    def next_due_s(self) -> float | None:
        """When the frame after the playhead is due, on the clock of `advance`; None while no clock runs."""
        return self._clock.due_s if self._playing else None

    def row(self, frame: int) -> Rows:
        """(D,) float32, one frame. Raises InvalidInput if it is not held."""
        self._check_held(frame, frame + 1)
        return self._rows[frame - self._first_kept]

    def held_rows(self, first_frame: int, end_frame: int) -> list[Rows]:
        """The rows of frames first_frame to end_frame - 1, as far as held; none if first_frame is not."""
        begin = first_frame - self._first_kept
        return self._rows[begin : end_frame - self._first_kept] if begin >= 0 else []

    def rows(self, first_frame: int, end_frame: int) -> Rows:
        """(T, D) float32, frames first_frame to end_frame - 1. Raises InvalidInput if any is not held."""
        self._check_held(first_frame, end_frame)
        return np.stack(self._rows[first_frame - self._first_kept : end_frame - self._first_kept])

    def _check_held(self, first_frame: int, end_frame: int) -> None:
        if not self._first_kept <= first_frame < end_frame <= self.buffered_to:
            allowed = f"frames within {self._first_kept} to {self.buffered_to - 1}, the ones held"
            raise InvalidInput("frames", (first_frame, end_frame - 1), allowed)

    def _start(self, frame: int) -> range:
        self._started = True
        first, self.playhead = self.playhead, frame
        return range(first, frame + 1)

    def _move(self, num_frames: int) -> range:
        first = self.playhead + 1
        self.playhead += num_frames
        return range(first, self.playhead + 1)

    def _forget(self, before: int) -> None:
        """Drop old frames, all of them before a frame: those that were newly reached are still to be read."""
        if self._keep_frames is None:
            return
        surplus = min(self.playhead - self._keep_frames, before) - self._first_kept
        if surplus > 0:
            del self._rows[:surplus]
            self._first_kept += surplus
