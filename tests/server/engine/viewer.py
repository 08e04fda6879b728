"""Viewer: a client that plays what it gets, and checks every rule of the protocol that a client may rely on."""

from __future__ import annotations

import bisect
import math

import numpy as np

from motiongen_server.engine.types import (
    Chunk,
    Closed,
    ConstraintReached,
    Opened,
    Outcome,
    Output,
    PlanCause,
    PlanNotice,
    Playhead,
    ServiceLevel,
    SessionKey,
)
from tests.server.engine.fakes import FRAME, PLAN


class RuleBroken(AssertionError):
    """The engine did something that the protocol forbids."""


def require(holds: bool, rule: str) -> None:
    if not holds:
        raise RuleBroken(rule)


class Viewer:
    """The client of one session. It plays in real time once it has a frame, and holds the last one when it runs out."""

    def __init__(self, key: SessionKey, lookahead: int, fps: int) -> None:
        self.key = key
        self.lookahead = lookahead
        self.fps = fps
        self.opened: Opened | None = None
        self.closed: Closed | None = None
        self.refused: Outcome | None = None
        self.rows: list[np.ndarray] = []
        self.notices: list[PlanNotice] = []
        self.chunks: list[Chunk] = []
        # which plan covers which frames: covering[i] from frame starts[i] on
        self.starts: list[int] = []
        self.covering: list[int] = []
        # plans whose frames may repeat the frame before
        self.held_plans: set[int] = set()
        self.levels: list[ServiceLevel] = []
        self.reached: list[ConstraintReached] = []
        self.outcomes: dict[int, Outcome] = {}
        self.asked: set[int] = set()
        self.close_seqs: set[int] = set()
        self.committed_to = 0
        self.reported = 0
        self.claimed = self.received_to = 0
        self.position = 0.0
        self.played_at: float | None = None
        self.paused = False
        self.honest = True
        self.rtt_s: float | None = None
        self.underruns = 0

    @property
    def buffered_to(self) -> int:
        return len(self.rows)

    @property
    def shown(self) -> int:
        """The frame being shown, -1 before playback has started."""
        return min(math.floor(self.position), self.buffered_to - 1) if self.played_at is not None else -1

    def play(self, now: float) -> None:
        """Advance playback to now."""
        if self.played_at is None or self.paused:
            return
        before = self.position
        self.position = min(before + (now - self.played_at) * self.fps, float(self.buffered_to))
        self.played_at = now
        if self.position == self.buffered_to > before:
            self.underruns += 1

    def report(self, now: float) -> Playhead:
        """Start playing, unless it has started, and report the playhead."""
        if self.played_at is None:
            self.played_at = now
        self.play(now)
        frame = max(0, self.shown)
        self.reported = max(self.reported, frame)
        return Playhead(self.key, 0, now, frame, self.buffered_to, self.underruns, self.rtt_s)

    def lie(self, frame: int, now: float) -> Playhead:
        """Report a frame that is not being shown. From then on the engine cannot know what was played."""
        self.honest = False
        self.claimed = max(self.claimed, frame)
        return Playhead(self.key, 0, now, frame, frame, 0)

    def set_paused(self, paused: bool, now: float) -> None:
        self.play(now)
        self.paused = paused
        if self.played_at is not None:
            self.played_at = now

    def take(self, output: Output, now: float) -> None:
        """Receive one output, now."""
        self.play(now)
        answers_late = isinstance(output, Outcome) and output.reason == "SESSION_NOT_OPEN"
        require(self.closed is None or answers_late, f"{type(output).__name__} after Closed")
        match output:
            case Opened():
                require(self.opened is None, "opened twice")
                self.opened = output
            case PlanNotice():
                self._take_notice(output)
            case Chunk():
                self._take_chunk(output)
            case Outcome():
                self._take_outcome(output)
            case ConstraintReached():
                require(output.frame < self.committed_to, f"{output} before its frame is promised")
                self.reached.append(output)
            case ServiceLevel():
                self.levels.append(output)
            case Closed():
                self.closed = output
                require(output.num_frames >= self.buffered_to, "fewer frames counted than sent")

    def _take_notice(self, notice: PlanNotice) -> None:
        expected = self.notices[-1].plan + 1 if self.notices else 1
        require(notice.plan == expected, f"plan {notice.plan} where {expected} was next")
        require(notice.valid_from >= self.committed_to, f"{notice} is below committed_to {self.committed_to}")
        if self.honest:
            require(notice.valid_from > self.shown, f"{notice} replaces frame {self.shown}, which is being shown")
        self.notices.append(notice)
        del self.rows[notice.valid_from :]
        while self.starts and self.starts[-1] >= notice.valid_from:
            self.starts.pop()
            self.covering.pop()
        if notice.cause is PlanCause.FALLBACK:
            self.held_plans.add(notice.plan)
        self.starts.append(notice.valid_from)
        self.covering.append(notice.plan)

    def _take_chunk(self, chunk: Chunk) -> None:
        require(self.notices != [] and chunk.plan == self.notices[-1].plan, f"chunk of plan {chunk.plan} is stale")
        require(chunk.first_frame == self.buffered_to, f"chunk at {chunk.first_frame}, not {self.buffered_to}")
        require(len(chunk.rows) > 0, "empty chunk")
        end = chunk.first_frame + len(chunk.rows)
        # A report counts only up to what had been sent; some of that was still on its way when it was made.
        playhead = max(self.reported, min(self.claimed, self.received_to))
        self.received_to = max(self.received_to, end)
        require(end <= playhead + self.lookahead, f"frames to {end} with the playhead at {playhead}")
        require(chunk.committed_to >= self.committed_to, "committed_to fell")
        self.committed_to = chunk.committed_to
        for frame, row in enumerate(chunk.rows, chunk.first_frame):
            covering = self.covering[bisect.bisect_right(self.starts, frame) - 1]
            if covering not in self.held_plans or not np.array_equal(row, self.rows[-1]):
                require(row[FRAME] == frame, f"frame {frame} holds {row[FRAME]}")
                require(row[PLAN] == covering, f"frame {frame} is of plan {row[PLAN]}, not {covering}")
            self.rows.append(row)
        self.chunks.append(chunk)

    def _take_outcome(self, outcome: Outcome) -> None:
        if self.opened is None:
            require(self.refused is None, "refused twice")
            self.refused = outcome
            return
        if outcome.event_seq in self.close_seqs:
            require(self.closed is not None, "a Close of an open session got an outcome")
            return
        require(outcome.event_seq in self.asked, f"an outcome for {outcome.event_seq}, which was not sent")
        require(outcome.event_seq not in self.outcomes, f"a second outcome for {outcome.event_seq}")
        self.outcomes[outcome.event_seq] = outcome
