"""What is heard of one session: every rule of the protocol is checked as it comes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from motiongen.v1 import motion_pb2, session_pb2


class RuleBroken(AssertionError):
    """The server did what the protocol forbids."""


def require(holds: bool, rule: str) -> None:
    if not holds:
        raise RuleBroken(rule)


@dataclass
class Heard:
    """What was said of one session, checked as it comes. sent_seq: the last number the test has used."""

    row_bytes: int
    sent_seq: int = 1
    playhead: int = 0
    opened: session_pb2.SessionOpened | None = None
    closed: session_pb2.SessionClosed | None = None
    is_resuming: bool = False
    goes_on_at: int = 0
    attempt: int = 0
    frames: dict[int, bytes] = field(default_factory=dict)
    plans: list[session_pb2.PlanNotice] = field(default_factory=list)
    chunks: list[motion_pb2.FrameChunk] = field(default_factory=list)
    outcomes: list[session_pb2.EditOutcome] = field(default_factory=list)
    levels: list[session_pb2.ServiceLevel] = field(default_factory=list)
    reached: list[session_pb2.ConstraintReached] = field(default_factory=list)
    applied_seq: int = 0
    durable_seq: int = 0
    next_frame: int = 0
    end: int = 0
    committed_to: int = 0

    def take(self, update: session_pb2.SessionUpdate) -> None:
        require(self.closed is None, "nothing is said of a session after SessionClosed")
        kind = update.WhichOneof("update")
        if self.is_resuming and kind == "outcome":
            require(update.outcome.event_seq == 1, "nothing but its refusal is told before a session is resumed")
        else:
            require(update.applied_seq >= self.applied_seq, "applied_seq never falls")
            self.applied_seq = update.applied_seq
        require(kind is not None, "an update says something")
        if kind == "outcome":
            self._take_outcome(update.outcome)
            return
        if kind == "opened":
            require(self.opened is None or self.is_resuming, "SessionOpened comes once, and once for each resume")
            if self.is_resuming:
                self._take_resumed(update.opened)
            else:
                self.next_frame = self.end = update.opened.start_frame
            if self.opened is None:
                self.row_bytes += 4 * sum(block.width for block in update.opened.outputs)
            self.opened, self.is_resuming = update.opened, False
            return
        require(not self.is_resuming, f"SessionOpened comes before {kind}")
        require(self.opened is not None, f"SessionOpened comes before {kind}")
        if kind == "plan":
            self._take_plan(update.plan)
        elif kind == "chunk":
            self._take_chunk(update.chunk)
        elif kind == "service_level":
            self.levels.append(update.service_level)
        elif kind == "constraint_reached":
            decided = update.constraint_reached.frame < self.committed_to or self.attempt > 0  # or told of again
            require(decided, "a constraint is told of when its frame is decided")
            self.reached.append(update.constraint_reached)
        elif kind == "durability":
            require(self.durable_seq <= update.durable_seq <= self.sent_seq, "durable_seq never falls, nor runs ahead")
            self.durable_seq = update.durable_seq
        elif kind == "closed":
            self.closed = update.closed

    def _take_resumed(self, opened: session_pb2.SessionOpened) -> None:
        assert self.opened is not None
        require(opened.session_token == self.opened.session_token, "a session keeps its token")
        require(opened.session_id == self.opened.session_id, "a session keeps its name")
        require(opened.start_frame <= self.next_frame, "a session goes on no later than where its client is")
        self.goes_on_at = opened.start_frame

    def _take_outcome(self, outcome: session_pb2.EditOutcome) -> None:
        self.outcomes.append(outcome)
        if outcome.code == 0:
            require(not (outcome.reason or outcome.field or outcome.allowed), "an accepted event has no reason")
            told = all(warning.reason and warning.message for warning in outcome.warnings)
            require(told, "a warning says what of, for programs and for people")
            return
        require(not outcome.warnings, "a refused event is not warned of")
        require(bool(outcome.reason and outcome.message), "a refusal says why, for programs and for people")
        require(not outcome.HasField("effective_frame"), "a refused event is in effect nowhere")

    def _take_plan(self, plan: session_pb2.PlanNotice) -> None:
        require(plan.plan > (self.plans[-1].plan if self.plans else 0), "plan numbers rise")
        require(plan.valid_from >= self.committed_to, "valid_from is not below committed_to")
        if plan.cause == session_pb2.PLAN_CAUSE_CONTINUE:
            require(plan.valid_from >= self.next_frame, "a continuation replaces nothing")
        else:
            causes = (session_pb2.PLAN_CAUSE_EDIT, session_pb2.PLAN_CAUSE_RESUME, session_pb2.PLAN_CAUSE_CUT)
            require(plan.cause in causes, "a plan has a cause")
            told = len(plan.event_seqs) > 0 or plan.cause == session_pb2.PLAN_CAUSE_RESUME
            require(told, "an edit's plan names its events")
        self.plans.append(plan)
        self.next_frame = min(self.next_frame, plan.valid_from)

    def _take_chunk(self, chunk: motion_pb2.FrameChunk) -> None:
        assert self.opened is not None
        require(bool(self.plans), "a PlanNotice precedes the first chunk")
        require(chunk.plan == self.plans[-1].plan, "a chunk is of the latest plan")
        require(chunk.first_frame == self.next_frame, "chunks neither leave out nor repeat a frame")
        require(chunk.frame_count >= 1, "a chunk holds a frame")
        require(len(chunk.data) == chunk.frame_count * self.row_bytes, "data is as long as its rows")
        require(bool(np.isfinite(np.frombuffer(chunk.data, "<f4")).all()), "frames are finite")
        require(chunk.scalar_type == self.opened.scalar_type, "the scalar type is the one agreed on")
        require(chunk.committed_to >= self.committed_to, "committed_to never falls")
        for row in range(chunk.frame_count):
            frame, data = chunk.first_frame + row, chunk.data[row * self.row_bytes : (row + 1) * self.row_bytes]
            known = self.frames.get(frame)
            require(known in (None, data) or frame >= self.committed_to, "a committed frame never changes")
            self.frames[frame] = data
        self.next_frame += chunk.frame_count
        require(self.next_frame <= self.playhead + self.opened.lookahead_frames, "no frame is sent beyond the credit")
        self.end = max(self.end, self.next_frame)
        self.committed_to = chunk.committed_to
        self.chunks.append(chunk)

    def outcome(self, event_seq: int) -> session_pb2.EditOutcome | None:
        """The answer to an event; fails where there are two, unless they are the same, told again to who resumed."""
        answers = [outcome for outcome in self.outcomes if outcome.event_seq == event_seq]
        same = all(answer == answers[0] for answer in answers)
        require(len(answers) <= 1 or (same and self.attempt > 0), "an event is answered once")
        return answers[0] if answers else None
