"""Delivery: which frames a client was sent, may be sent, and was promised not to change again."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.plan_log import PlanLog
from motiongen_server.engine.session.playback import PlaybackClock, RoundTrip
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import Chunk, Output, PlanCause, PlanNotice, Playhead, Resume, Resumed, SessionKey

# A wake-up computed in floating point may come slightly early; the tolerance avoids another one for the same frame.
_FRAME_TOLERANCE = 1e-3


@dataclass(slots=True)
class Delivery:
    """The delivery of one session's frames to its client. sent_to, committed_to: exclusive frame bounds.

    far_frames: how many frames further away the client is than was assumed. num_frames, late_frames: how many frames
    were sent, each counted once, and how many of them after they were due.
    """

    session: SessionKey
    lookahead: int
    config: EngineConfig
    clock: PlaybackClock
    round_trip: RoundTrip
    sent_to: int = 0
    committed_to: int = 0
    far_frames: int = 0
    first_chunk_due: bool = True
    num_frames: int = 0
    late_frames: int = 0
    plan_log: PlanLog = field(default_factory=PlanLog)

    # ---- leads ------------------------------------------------------------------------------------------------------

    @property
    def delivery_s(self) -> float:
        """How long a notice takes to reach the client's screen, in seconds."""
        return self.round_trip.seconds + self.config.flush_s

    @property
    def commit_s(self) -> float:
        """How far beyond the playhead frames are committed, in seconds."""
        return self.round_trip.seconds + self.config.flush_s + self.config.margin_s

    @property
    def commit_frames(self) -> int:
        """The same in frames, counted from the frame being shown."""
        return math.ceil(self.clock.fps * self.commit_s) + 1

    def unplayed(self, now: float, planned_to: int) -> float:
        """Frames from the playhead to the end of the plan."""
        return planned_to - self.clock.estimate(now, self.sent_to)

    def runs_low(self, now: float, planned_to: int, frames: int) -> bool:
        """Whether the client has at most this many frames left to play."""
        return self.unplayed(now, planned_to) <= frames + _FRAME_TOLERANCE

    def unplayed_at_pace(self, now: float, planned_to: int) -> float:
        """The same for a playhead that has not jumped ahead."""
        return planned_to - self.clock.paced(now, self.sent_to)

    def unshown_from(self, now: float, lead_s: float) -> int:
        """The first frame that the client cannot be showing lead_s from now."""
        # A client that reports frame f may be anywhere from f up to, not including, f + 1.
        return math.ceil(self.clock.estimate(now, self.sent_to) + self.clock.fps * lead_s) + 1

    def reaches_at(self, frame: int) -> float:
        """When the playhead reaches a frame; infinity if it does not without an event: it stops at sent_to."""
        return self.clock.reaches_at(frame) if frame <= self.sent_to else math.inf

    def sends_at(self, planned_to: int) -> float:
        """When frames that the credit allows, but that wait for more, are sent for time alone; infinity: none wait."""
        if not self.clock.running or self._limit(planned_to) <= self.sent_to:
            return math.inf
        return self.clock.reaches_at(self.sent_to - self._low_frames)

    # ---- changes ----------------------------------------------------------------------------------------------------

    def report(self, event: Playhead) -> None:
        self.clock.report(event.frame, event.received_at, self.sent_to)
        self.plan_log.confirm(self.clock.reported)
        self.round_trip.report(event.rtt_s, event.received_at)
        self.far_frames = max(0, math.ceil(self.clock.fps * (self.round_trip.seconds - self.config.rtt_s)))

    def grant(self, frame: int) -> None:
        """The client of a clip has taken the frames below `frame`."""
        self.clock.credited = max(self.clock.credited, min(frame, self.sent_to))

    def superseded(self, frame: int) -> int:
        """A plan replaces the frames from `frame` on. Returns how many of those were sent and are now void."""
        void = max(0, self.sent_to - frame)
        self.sent_to -= void
        return void

    def resume(self, event: Resume, plan: int, first_held: int) -> list[Output]:
        """Continue with a client that lost its connection, with one notice for all the plans that it missed.

        plan: the newest plan. first_held: the first frame that can still be sent. If the client's state is not
        possible, it is told that its frames are not held.
        """
        replaced_from, event_seqs = self.plan_log.missed(event.plan, event.next_frame)
        # Frames that it has shown stay valid, even if a plan that it never heard of replaced them.
        valid_from = max(replaced_from, self.clock.reported)
        start = min(event.next_frame, valid_from)
        if event.plan > plan or not first_held <= start <= self.sent_to:
            return [Resumed(self.session, event.attempt, None)]
        self.sent_to = start
        missed = event.plan < plan
        notice = PlanNotice(self.session, plan, valid_from, PlanCause.RESUME, event_seqs) if missed else None
        return [Resumed(self.session, event.attempt, start, notice)]

    def promise(self, frame: int) -> None:
        """Frames below `frame` will not change."""
        self.committed_to = max(self.committed_to, frame)

    def promised(self, now: float, planned_to: int, promise_to: float) -> int:
        """The end of what the next chunk promises: frames that no replan could change in time; at most promise_to."""
        return int(min(self.unshown_from(now, self.commit_s), self._limit(planned_to), promise_to))

    def waits(self, now: float, planned_to: int) -> bool:
        """Whether frames that the credit allows should wait until more of the plan can be sent with them.

        Each playhead report earns a few frames, and a message of few costs as much as one of many. A client that runs
        low, or whose playhead stands, gets what there is.
        """
        num_frames = self._limit(planned_to) - self.sent_to
        if num_frames <= 0 or self.first_chunk_due or not self.clock.running:
            return False
        enough = min(self.config.steady_chunk, self.lookahead // 2, planned_to - self.sent_to)
        return num_frames < enough and not self.runs_low(now, self.sent_to, self._low_frames)

    def chunks(self, now: float, timeline: Timeline, plan: int, promise_to: float) -> list[Chunk]:
        """Send what the credit allows: a short chunk first if a plan is new, then chunks of up to steady_chunk frames.

        Promises the frames that no replan could change in time, but none from promise_to on.
        """
        limit, begin = self._limit(timeline.end), self.sent_to
        if limit <= begin:
            return []
        due_to = math.ceil(self.clock.unheld(now)) if self.clock.running else 0
        self.clock.resume_from(begin, now)
        self.promise(self.promised(now, timeline.end, promise_to))
        chunks = []
        while self.sent_to < limit:
            most = self.config.first_chunk if self.first_chunk_due else self.config.steady_chunk
            end = min(self.sent_to + most, limit)
            rows = timeline.rows_between(self.sent_to, end)
            chunks.append(Chunk(self.session, plan, self.sent_to, rows, self.committed_to))
            self.first_chunk_due = False
            self.sent_to = end
        self.num_frames = max(self.num_frames, limit)
        self.late_frames += max(0, min(due_to, limit) - begin)
        return chunks

    def _limit(self, planned_to: int) -> int:
        """The end of the frames that the credit allows."""
        return min(planned_to, self.clock.credited + self.lookahead)

    @property
    def _low_frames(self) -> int:
        """Frames left to play below which a client is sent what there is.

        Reports that come often enough earn a whole chunk before so few are left.
        """
        return min(3 * self.config.steady_chunk // 4, self.lookahead // 2)
