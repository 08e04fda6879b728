"""Heard: what the client has received about one session. Every rule of the protocol is checked on arrival."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import grpc
import numpy as np

from motiongen.v1 import motion_pb2, session_pb2

_REPLACING = (session_pb2.PLAN_CAUSE_EDIT, session_pb2.PLAN_CAUSE_CUT)
"""Causes of plans that apply events of the client."""
_BY_ITSELF = (session_pb2.PLAN_CAUSE_FALLBACK, session_pb2.PLAN_CAUSE_RESUME)
"""Causes of plans that a server may make without any event."""
_WAITING_HELPS = (grpc.StatusCode.RESOURCE_EXHAUSTED.value[0], grpc.StatusCode.UNAVAILABLE.value[0])
_MOST_CODE = 16
_REASON = re.compile(r"[A-Z][A-Z0-9]*(_[A-Z0-9]+)*")
_BYTES_A_NUMBER = {motion_pb2.SCALAR_TYPE_F32_LE: 4, motion_pb2.SCALAR_TYPE_F16_LE: 2}


class RuleBroken(AssertionError):
    """The server broke a rule of the protocol."""


def require(holds: bool, rule: str) -> None:
    if not holds:
        raise RuleBroken(rule)


@dataclass
class Heard:
    """What was received about one session, checked on arrival.

    row_bytes: size of a frame row: as F32_LE at first, and in the session's own form once SessionOpened has come.
    num_joints: of the rig. sent_seq: the last event number that the test has used. said_seq: the greatest one that was
    sent. lookahead: frames, as agreed last. goes_on_at: start_frame of the last resume. answered: numbers of events;
    answered_to: all up to this one are among them.
    """

    row_bytes: int
    num_joints: int = 0
    sent_seq: int = 1
    said_seq: int = 1
    lookahead: int = 0
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
    answered: set[int] = field(default_factory=set)
    answered_to: int = 0
    durable_seq: int = 0
    next_frame: int = 0
    end: int = 0
    committed_to: int = 0
    last_kind: str = ""

    def take(self, update: session_pb2.SessionUpdate) -> None:
        require(self.closed is None, "no update of a session follows its SessionClosed")
        kind = update.WhichOneof("update")
        if self.is_resuming and kind == "outcome":
            require(update.outcome.event_seq == 1, "before a session is resumed, no outcome comes but a refusal")
        else:
            require(update.applied_seq >= self.applied_seq, "applied_seq never falls")
            require(update.applied_seq <= self._most_seq, "applied_seq is not above what was sent")
            self.applied_seq = update.applied_seq
            self._count_answers(update)
            # SessionClosed answers what is left, and after a resume the answers follow updates that count them
            is_told = kind == "closed" or self.attempt > 0 or self.applied_seq <= self.answered_to
            require(is_told, "every event up to applied_seq has been answered")
        require(kind is not None, "an update has a member")
        require(kind == "durability" or not update.durable_seq, "durable_seq is set beside durability only")
        before, self.last_kind = self.last_kind, kind or ""
        if kind == "outcome":
            self._take_outcome(update.outcome)
            return
        if kind == "opened":
            require(self.opened is None or self.is_resuming, "SessionOpened comes once, and once for each resume")
            if self.is_resuming:
                self._take_resumed(update.opened)
            else:
                require(update.opened.start_frame == 0, "a new session begins with frame 0")
            if self.opened is None:
                self.row_bytes = self._row_bytes_of(update.opened)
            self.opened, self.is_resuming, self.lookahead = update.opened, False, update.opened.lookahead_frames
            return
        require(not self.is_resuming, f"SessionOpened comes before {kind}")
        require(self.opened is not None, f"SessionOpened comes before {kind}")
        if kind == "plan":
            is_resume = update.plan.cause == session_pb2.PLAN_CAUSE_RESUME
            told = before == "opened" and self.attempt > 0
            require(told or not is_resume, "a RESUME plan comes right after the SessionOpened of a resume")
            self._take_plan(update.plan)
        elif kind == "chunk":
            self._take_chunk(update.chunk)
        elif kind == "service_level":
            level = update.service_level
            is_held = level.tier == session_pb2.SERVICE_TIER_HOLD
            require(level.tier != session_pb2.SERVICE_TIER_UNSPECIFIED, "a ServiceLevel has a tier")
            require(is_held == (level.denoise_steps == 0), "a tier has denoising steps, and HOLD has none")
            self.levels.append(level)
        elif kind == "constraint_reached":
            decided = update.constraint_reached.frame < self.committed_to or self.attempt > 0  # or sent again
            require(decided, "ConstraintReached comes once its frame is committed")
            news = update.constraint_reached
            told = any((each.constraint_id, each.frame) == (news.constraint_id, news.frame) for each in self.reached)
            require(self.attempt > 0 or not told, "ConstraintReached comes once for a constraint")
            self.reached.append(news)
        elif kind == "durability":
            require(self.durable_seq <= update.durable_seq <= self._most_seq, "durable_seq never falls or runs ahead")
            self.durable_seq = update.durable_seq
        elif kind == "closed":
            require(update.closed.reason != session_pb2.CLOSE_REASON_UNSPECIFIED, "a session is closed for a reason")
            self.closed = update.closed

    def _count_answers(self, update: session_pb2.SessionUpdate) -> None:
        if update.HasField("opened"):
            self.answered.add(1)
        elif update.HasField("outcome"):
            self.answered.add(update.outcome.event_seq)
        while self.answered_to + 1 in self.answered:
            self.answered_to += 1

    @property
    def _most_seq(self) -> int:
        return max(self.sent_seq, self.said_seq)

    def _row_bytes_of(self, opened: session_pb2.SessionOpened) -> int:
        """The size of a frame row as the session stores it, with its outputs."""
        if opened.scalar_type == motion_pb2.SCALAR_TYPE_QUANTISED:
            sizes = {"joint_global_rotation_quat_wxyz": 1}
            return 13 + 4 * self.num_joints + sum(sizes.get(each.name, 2) * each.width for each in opened.outputs)
        require(opened.scalar_type in _BYTES_A_NUMBER, "a session has a scalar type")
        numbers = self.row_bytes // 4 + sum(block.width for block in opened.outputs)
        return _BYTES_A_NUMBER[opened.scalar_type] * numbers

    def _take_resumed(self, opened: session_pb2.SessionOpened) -> None:
        assert self.opened is not None
        require(opened.session_token == self.opened.session_token, "a session keeps its token")
        require(opened.session_id == self.opened.session_id, "a session keeps its name")
        require(opened.start_frame <= self.next_frame, "a resumed session starts at next_frame or before")
        self.goes_on_at = self.next_frame = opened.start_frame

    def _take_outcome(self, outcome: session_pb2.EditOutcome) -> None:
        if outcome.HasField("effective_frame") and self.attempt == 0:
            is_planned = any(outcome.event_seq in plan.event_seqs for plan in self.plans)
            is_ahead = outcome.effective_frame >= self.next_frame
            require(is_planned or is_ahead, "an edit of frames that were sent is answered after the notice of its plan")
        self.outcomes.append(outcome)
        require(outcome.event_seq <= self._most_seq, "an outcome is for an event that was sent")
        if outcome.code == 0:
            why = outcome.reason or outcome.message or outcome.field or outcome.allowed
            require(not why and not outcome.HasField("retry_after"), "an accepted event has no reason")
            told = all(warning.reason and warning.message for warning in outcome.warnings)
            require(told, "a warning has a reason and a message")
            return
        require(not outcome.warnings, "a refused event has no warnings")
        require(not outcome.placements, "a refused event has no placements")
        require(0 < outcome.code <= _MOST_CODE, "a refusal has a google.rpc.Code")
        require(bool(outcome.reason and outcome.message), "a refusal has a reason and a message")
        require(_REASON.fullmatch(outcome.reason) is not None, "a reason is in UPPER_SNAKE_CASE")
        waits = not outcome.HasField("retry_after") or outcome.code in _WAITING_HELPS
        require(waits, "retry_after is for RESOURCE_EXHAUSTED and UNAVAILABLE only")
        require(not outcome.HasField("effective_frame"), "a refused event has no effective_frame")

    def _take_plan(self, plan: session_pb2.PlanNotice) -> None:
        require(plan.plan > (self.plans[-1].plan if self.plans else 0), "plan numbers rise")
        require(plan.valid_from >= self.committed_to, "valid_from is not below committed_to")
        if plan.cause == session_pb2.PLAN_CAUSE_CONTINUE:
            require(plan.valid_from >= self.next_frame, "a continuation replaces nothing")
        else:
            require(plan.cause in (*_REPLACING, *_BY_ITSELF), "a plan has a cause")
            require(len(plan.event_seqs) > 0 or plan.cause in _BY_ITSELF, "an edit's plan names its events")
        require(all(0 < seq <= self._most_seq for seq in plan.event_seqs), "a plan names events that were sent")
        self.plans.append(plan)
        self.next_frame = min(self.next_frame, plan.valid_from)

    def _take_chunk(self, chunk: motion_pb2.FrameChunk) -> None:
        assert self.opened is not None
        require(bool(self.plans), "a PlanNotice precedes the first chunk")
        require(chunk.plan == self.plans[-1].plan, "a chunk has the number of the latest plan")
        require(chunk.first_frame == self.next_frame, "chunks neither leave out nor repeat a frame")
        require(chunk.frame_count >= 1, "a chunk holds a frame")
        require(chunk.scalar_type == self.opened.scalar_type, "a chunk has the session's scalar type")
        require(len(chunk.data) == chunk.frame_count * self.row_bytes, "data is as long as its rows")
        if chunk.scalar_type in _BYTES_A_NUMBER:
            numbers = np.frombuffer(chunk.data, f"<f{_BYTES_A_NUMBER[chunk.scalar_type]}")
            require(bool(np.isfinite(numbers).all()), "frames are finite")
        is_relative = chunk.scalar_type == motion_pb2.SCALAR_TYPE_F16_LE
        require(len(chunk.root_origin_m) == 3 * is_relative, "F16_LE has a root_origin_m, and other types have none")
        require(chunk.committed_to >= self.committed_to, "committed_to never falls")
        for row in range(chunk.frame_count):
            frame, data = chunk.first_frame + row, chunk.data[row * self.row_bytes : (row + 1) * self.row_bytes]
            known = self.frames.get(frame)
            is_same = known in (None, data) or is_relative  # its origin may differ when it is sent again
            require(is_same or frame >= self.committed_to, "a committed frame never changes")
            self.frames[frame] = data
        self.next_frame += chunk.frame_count
        require(self.next_frame <= self.playhead + self.lookahead, "no frame is sent beyond the credit")
        self.end = max(self.end, self.next_frame)
        self.committed_to = chunk.committed_to
        self.chunks.append(chunk)

    def outcome(self, event_seq: int) -> session_pb2.EditOutcome | None:
        """The answer to an event. Two answers break a rule, unless they are equal and the session was resumed."""
        answers = [outcome for outcome in self.outcomes if outcome.event_seq == event_seq]
        same = all(answer == answers[0] for answer in answers)
        require(len(answers) <= 1 or (same and self.attempt > 0), "an event is answered once")
        return answers[0] if answers else None
