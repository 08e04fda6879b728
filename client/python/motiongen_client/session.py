"""Session: one character, its frames and its end. It belongs to a `Stream` and runs on one event loop."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from dataclasses import dataclass

from motiongen.v1 import session_pb2
from motiongen_client.carrier import Carrier
from motiongen_client.conversation import Conversation
from motiongen_client.motion import Frame, Motion, Rig
from motiongen_client.posing import Poser
from motiongen_client.reopening import Line
from motiongen_client.sampling import Sampler
from motiongen_client.types import Catalog, SessionEnd, check_finite, check_flag, check_frame


@dataclass(frozen=True)
class SessionStats:
    """Counts and times of one session so far.

    opened_s, first_frame_s: seconds from the call of `open` to the server's answer and to the first frame.
    plans: plans received, including replans; frames: frames received, including those replaced later.
    underruns: frame times for which the last pose had to be held; late_plans: plans that began behind the playhead.
    resumes, reopenings: how often the session continued after a loss, by being resumed and by being opened anew.
    """

    opened_s: float
    first_frame_s: float | None
    plans: int
    frames: int
    underruns: int
    late_plans: int
    resumes: int = 0
    reopenings: int = 0


@dataclass(frozen=True)
class Glance:
    """The frame to show, and for how long: up to until_s on the session's clock, unless something arrives first.

    count: `Changes.count` when it was taken. until_s: None if the next call may find another frame.
    """

    frame: Frame | None
    count: int
    until_s: float | None


class Session(Conversation):
    """One character. Made by `Stream.open`; do not construct it yourself.

    Changes (`set_prompt`, `add_waypoint`, …) are sent at once, in order, and return an `Edit`. Frames come from
    `frames()`, or from `poll()` for a loop that draws at its own pace; use only one of the two.

    When the connection to the server is lost, the session continues as soon as there is another. The application need
    not do anything, and viewers see nothing of it while buffered frames last. If the server could not resume the
    session, it is opened anew: `reopenings` gets an entry, and `on_reopened`, if set, is called.

    service_level: how well the server serves it at present; `on_service_level`, if set, is called when it changes.
    `on_constraint_reached`, if set, is called for each constraint once its last frame can no longer change.
    """

    def __init__(self, handle: int, carrier: Carrier, catalog: Catalog, clock: Callable[[], float]) -> None:
        super().__init__(handle, carrier, catalog, clock)
        self._poser: Poser | None = None
        self._sampler: Sampler | None = None
        self._sampled_rig: Rig
        self._untold = range(0)  # frames that the playhead has reached, but `frames` has not yielded yet

    # ---- the end

    async def close(self) -> SessionEnd:
        """End the session. Returns how it ended; calling it again returns the same.

        If the connection is lost, or is lost before the server has answered, the session ends here at once, and on the
        server when its grace period is over.
        """
        if self._end is None and self._failure is None and self._line is not Line.LOST and not self._is_closing:
            self._send(session_pb2.SessionEvent(close=session_pb2.CloseSession()))
        while self._end is None:
            if self._failure is not None:
                raise self._failure
            if self._line is Line.LOST:
                end = SessionEnd("client", "it was closed while the connection was lost", self._num_frames, 0)
                self._finish(end)
                return end
            self._changed.clear()
            await self._changed.wait()
        return self._end

    async def __aenter__(self) -> Session:
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._failure is None:
            await self.close()

    # ---- frames

    @property
    def end(self) -> SessionEnd | None:
        """How the session ended; None while it lives."""
        return self._end

    @property
    def stats(self) -> SessionStats:
        """Counts and times so far."""
        return SessionStats(
            opened_s=self._opened_s,
            first_frame_s=self._first_frame_s,
            plans=self._num_plans,
            frames=self._num_frames,
            underruns=self.playback.underruns,
            late_plans=self.playback.late_plans,
            resumes=self._num_resumes,
            reopenings=self._num_reopenings,
        )

    def frame_in(self, seconds: float) -> int:
        """The frame that will be shown `seconds` from now."""
        check_finite("seconds", seconds)
        return self.playback.playhead + self.rig.frames_in(seconds)

    async def frames(self, seconds: float | None = None, *, realtime: bool = True) -> AsyncGenerator[Frame, None]:
        """Yield each frame once, in order: the next `seconds` of motion, or all until the session is closed.

        realtime: yield each frame when it is due; while the server is late, the last pose is held (nothing is yielded,
        `stats.underruns` rises). Otherwise frames come as fast as they are generated and consumed; while an edit is
        unanswered, only those that it can no longer change.
        A later call of `frames` continues without a gap where an earlier one ended or was left.
        Raises SessionEnded if the server ends the session and StreamLost if the stream breaks: after the buffered
        frames, or at once if the session is paused, since those would never become due.
        """
        if seconds is not None:
            check_finite("seconds", seconds)
        check_flag("realtime", realtime)
        num_left = None if seconds is None else self.rig.frames_in(seconds)
        while num_left is None or num_left > 0:
            self._changed.clear()
            if self._is_over(realtime):
                return
            if not self._untold:
                self._untold = self._advance() if realtime else self._step()
            is_told_some = bool(self._untold)
            while self._untold:
                index, self._untold = self._untold[0], self._untold[1:]
                yield self._frame(index)
                if num_left is not None:
                    num_left -= 1
                    if num_left == 0:
                        return
            if realtime or not is_told_some:
                await self._wait(realtime)

    def poll(self) -> Frame | None:
        """Move the playhead to the present and return the frame to show now; None before the first has arrived.

        For a loop that draws at its own pace. Raises SessionEnded or StreamLost once no frame is left to show, or at
        once if the session is paused.
        """
        if not self._is_over(True):
            self._advance()
            self._untold = range(0)
        if not self.playback.started:
            return None
        return self._frame(self.playback.playhead)

    def glance(self) -> Glance:
        """As `poll`, with how long the frame will be shown, so that other threads need not ask each time."""
        count = self._changed.count
        frame = self.poll()
        is_closed = self._end is not None and self._end.reason == "client"  # else poll shows what is left, then raises
        is_moving = self.playback.is_playing and not is_closed
        until_s = self.playback.next_due_s() if is_moving else math.inf
        return Glance(frame, count, until_s if frame is not None else None)

    def is_same(self, glance: Glance) -> bool:
        """Whether `poll` would return the glance's frame. May be called from any thread."""
        return glance.until_s is not None and self._changed.count == glance.count and self._clock() < glance.until_s

    def sample(self) -> Frame | None:
        """As `poll`, but with the pose interpolated between two frames for this moment: for a loop at 60 or 144 Hz.

        A jump caused by a replan or an underrun is faded out (`sampling`). Use either this or `poll`. The frame has no
        outputs, since only the server's own frames have them.
        """
        if self.poll() is None:
            return None
        if self._sampler is None:
            self._sampler, self._sampled_rig = Sampler(self.rig, self.playback), self.rig.with_outputs({})
        share, row = self._sampler.row(self._clock())
        return Frame(self._sampled_rig, self.playback.playhead, row, share=share)

    def set_time_scale(self, scale: float) -> None:
        """Play slower or faster than real time: 0.5 is half as fast. The server may not keep up far above 1."""
        self.playback.set_time_scale(scale)
        self._changed.set()

    def motion(self, first_frame: int | None = None, end_frame: int | None = None) -> Motion:
        """The frames shown so far that are still kept, or those from first_frame up to end_frame - 1."""
        for name, value in (("first_frame", first_frame), ("end_frame", end_frame)):
            if value is not None:
                check_frame(name, value)
        first = self.playback.first_kept if first_frame is None else first_frame
        shown_to = self.playback.playhead + 1 if self.playback.started else self.playback.playhead
        rows = self.playback.rows(first, shown_to if end_frame is None else end_frame)
        return Motion(self.rig, first, rows)

    def _frame(self, index: int) -> Frame:
        if self._poser is None:
            self._poser = Poser(self.rig, self.playback)
        return Frame(self.rig, index, self.playback.row(index), self._poser)

    def _advance(self) -> range:
        was_started = self.playback.started
        reached = self.playback.advance(self._clock())
        if reached and not was_started:
            self._carrier.report_soon()  # the server starts its copy of the playhead's clock with this report
        return reached

    def _step(self) -> range:
        """Move the playhead by one frame, before that frame is due.

        The server lets an edit take effect just beyond where a playhead in real time can be. So while an edit is
        unanswered, no frame that it might replace may be consumed.
        """
        playback = self.playback
        target = playback.playhead + 1 if playback.started else playback.playhead
        awaits = self._edits.is_waiting and self._line is Line.OPEN
        taken_to = min(playback.committed_to, playback.buffered_to) if awaits else playback.buffered_to
        if target >= taken_to:
            return range(0)
        reached = playback.advance_to(target)
        self._is_ahead = True
        if target + 1 == taken_to:
            self._carrier.report_soon()  # nothing left to consume: ask for more at once
        return reached

    def _is_over(self, realtime: bool) -> bool:
        """Whether the application closed the session. Raises if it ended otherwise and no frame is left."""
        if self._end is not None and self._end.reason == "client":
            return True
        if self._failure is None:
            return False
        playback = self.playback
        stands = realtime and not playback.is_playing  # for good: nothing can make it go on
        if not self._untold and (stands or playback.playhead >= playback.buffered_to - 1):
            raise self._failure
        return False

    async def _wait(self, realtime: bool) -> None:
        """Wait until the next frame is due, or something arrives; another time scale, a pause or the end count too."""
        due_s = self.playback.next_due_s() if realtime else None
        if due_s is None:
            if self._failure is None:  # otherwise nothing will arrive
                await self._changed.wait()
            return
        wait_s = due_s - self._clock()
        if wait_s <= 0 and self.playback.buffered_to > self.playback.playhead + 1:
            await asyncio.sleep(0)  # a caller that is late gets the next frame at once
            return
        try:
            async with asyncio.timeout(wait_s if wait_s > 0 else 1 / self.rig.frame_rate_hz):
                await self._changed.wait()
        except TimeoutError:
            pass  # the frame is due; or one more frame time has passed without a new one, which `advance` counts
