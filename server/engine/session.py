"""SessionState: one character's state, and its transitions: apply, next_window, accept, emit.

Transitions are deterministic in the state and their arguments; time comes in as `now`, nothing goes out but what they
return and what they tally in the StepReport. The rules:

- Frames below `committed_to` never change, and it never falls.
- A window starts at a commit frame, which the client cannot have played when the window lands, or at the end of the
  plan. One that lands too late is discarded, and its edits are tried again with a longer lead.
- All edits that wait when a window starts are answered by that window. One that arrives while a window runs cuts the
  window (a prompt that starts inside it), restarts it (less than half of its steps are done), or follows it.
- A window is taken only up to the next change of prompt, so the window after it starts there with the new prompt.
- No frame is sent at or beyond the reported playhead + lookahead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from server.engine.conditions import Conditions, EditRefused, edit_constraints, edit_prompts
from server.engine.config import EngineConfig
from server.engine.report import EventLatency, StepReport
from server.engine.timeline import PlaybackClock, Timeline
from server.engine.types import (
    Chunk,
    Closed,
    CloseReason,
    Code,
    ModelFacts,
    Opened,
    Outcome,
    Output,
    PlanCause,
    PlanNotice,
    Playhead,
    SessionKey,
    SessionSpec,
    SetConstraints,
    SetPlayState,
    SetPrompts,
    SetVelocity,
    WindowJob,
    WindowResult,
)

# A wake-up computed in floating point may come a hair early; the tolerance keeps it from being asked for again.
_FRAME_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class PendingEdit:
    """An edit that waits for the plan that answers it. dirty_from: the first frame it wants changed."""

    event_seq: int
    kind: str
    received_at: float
    dirty_from: int


@dataclass(frozen=True, slots=True)
class RunningWindow:
    """The window being denoised. accept_to: its frames from there on will be dropped. answers: the edits it is for."""

    job: WindowJob
    accept_to: int
    answers: tuple[PendingEdit, ...]
    predicted_s: float
    steps_done: int = 0

    @property
    def first_frame(self) -> int:
        return self.job.first_frame


@dataclass(slots=True)
class SessionState:
    """All that is known of a session. sent_to, committed_to: exclusive frame bounds; plan: the newest plan's number."""

    spec: SessionSpec
    facts: ModelFacts
    config: EngineConfig
    continue_threshold: int
    conditions: Conditions
    clock: PlaybackClock
    timeline: Timeline
    opened_at: float
    last_playhead_at: float
    plan: int = 0
    sent_to: int = 0
    committed_to: int = 0
    pending: tuple[PendingEdit, ...] = ()
    running: RunningWindow | None = None
    restarts: int = 0
    extra_lead_s: float = 0.0
    first_chunk_due: bool = True
    unseen: list[tuple[PendingEdit, int]] = field(default_factory=list)
    underruns: int = 0
    num_frames: int = 0
    late_frames: int = 0

    @property
    def key(self) -> SessionKey:
        return self.spec.session

    @property
    def planned_to(self) -> int:
        return self.timeline.end

    # ---- opening and closing ----------------------------------------------------------------------------------------

    @classmethod
    def opened(
        cls, spec: SessionSpec, received_at: float, ordinal: int, facts: ModelFacts, config: EngineConfig, now: float
    ) -> SessionState:
        """A new session. ordinal: how many were opened before it; it spreads the start times of later windows."""
        jitter = math.floor((ordinal * 0.618033988749895) % 1.0 * (config.continue_jitter + 1))
        return cls(
            spec=spec,
            facts=facts,
            config=config,
            # A client that asks for a longer lookahead wants it filled.
            continue_threshold=max(config.continue_threshold, spec.lookahead - facts.horizon) + jitter,
            conditions=Conditions(spec.prompts, spec.constraints),
            clock=PlaybackClock(facts.fps),
            timeline=Timeline.empty(facts.row_width, facts.feature_dim),
            opened_at=received_at,
            last_playhead_at=now,
        )

    def greeting(self) -> Opened:
        return Opened(
            self.key,
            self.spec.seed,
            start_frame=0,
            lookahead=self.spec.lookahead,
            committed_horizon=math.ceil(self.facts.fps * self.config.commit_s) + 1,
            denoise_steps=self.spec.denoise_steps,
        )

    def close(self, reason: CloseReason, code: Code, message: str) -> list[Output]:
        """Answer every edit that still waits, then say goodbye. The session must not be used again."""
        waiting = (*(self.running.answers if self.running else ()), *self.pending)
        outputs: list[Output] = [
            Outcome(self.key, edit.event_seq, Code.CANCELLED, None, "SESSION_CLOSED", "the session closed before it")
            for edit in waiting
        ]
        self.running, self.pending = None, ()
        return [*outputs, Closed(self.key, reason, code, message, self.num_frames, self.late_frames)]

    # ---- events -----------------------------------------------------------------------------------------------------

    def apply(
        self, event: SetPrompts | SetConstraints | SetVelocity | Playhead | SetPlayState, now: float, report: StepReport
    ) -> list[Output]:
        """Take in one event. If this ends the running window (`running` becomes None), its job is to be discarded."""
        match event:
            case Playhead():
                self._report_playhead(event, now, report)
                return []
            case SetPlayState():
                self.clock.set_state(event.state, event.received_at, self.sent_to)
                return [Outcome(self.key, event.event_seq, Code.OK)]
            case SetVelocity():
                return [Outcome(self.key, event.event_seq, Code.UNIMPLEMENTED, None, "UNIMPLEMENTED", "")]
            case SetPrompts() | SetConstraints():
                try:
                    return self._edit(event, now, report)
                except EditRefused as refused:
                    return [refused.outcome(self.key, event.event_seq)]

    def _report_playhead(self, event: Playhead, now: float, report: StepReport) -> None:
        self.last_playhead_at = now
        self.clock.report(event.frame, event.received_at, self.sent_to)
        if event.underruns > self.underruns:
            report.client_underruns.append((self.spec.priority, event.underruns - self.underruns))
            self.underruns = event.underruns
        report.slacks.append((self.spec.priority, (event.buffered_to - event.frame) / self.facts.fps))

    def _edit(self, event: SetPrompts | SetConstraints, now: float, report: StepReport) -> list[Output]:
        floor = self._replaceable_from(now, self.config.commit_s)
        if isinstance(event, SetPrompts):
            kind = "prompts"
            self.conditions, dirty_from = edit_prompts(self.conditions, event, floor, self.config.max_prompts)
        else:
            kind = "constraints"
            limit = self.config.max_constraints
            self.conditions, changed = edit_constraints(self.conditions, event, floor, limit)
            # A window that starts at floor sees this far; what lies beyond waits until a later window sees it.
            reach = self.facts.max_window_frames - self._history_at(floor)
            first = min((item.first_frame for item in changed if item.last_frame >= floor), default=None)
            dirty_from = None if first is None else max(floor, first - reach + 1)
        if dirty_from is None:
            return [Outcome(self.key, event.event_seq, Code.OK)]
        if dirty_from > 0:
            dirty_from = max(dirty_from, self.facts.patch)
        edit = PendingEdit(event.event_seq, kind, event.received_at, dirty_from)
        running = self.running
        if running is not None and running.first_frame < dirty_from < running.accept_to and kind == "prompts":
            self.running = replace(running, accept_to=dirty_from, answers=(*running.answers, edit))
            return []
        self.pending = (*self.pending, edit)
        if running is not None and dirty_from < running.accept_to and self._worth_restarting(running):
            self._withdraw(running)
            self.restarts += 1
            report.windows_restarted += 1
        return self._settle()

    def _worth_restarting(self, running: RunningWindow) -> bool:
        return running.steps_done * 2 < running.job.num_steps and self.restarts < self.config.max_restarts

    def _withdraw(self, running: RunningWindow) -> None:
        """Forget the running window; its edits wait again."""
        self.pending = (*running.answers, *self.pending)
        self.running = None

    def _settle(self) -> list[Output]:
        """Answer the edits that ask for frames which no window has touched yet: they will be there when it comes."""
        untouched_from = max(self.planned_to, self.running.accept_to if self.running else 0)
        settled = [edit for edit in self.pending if 0 < untouched_from <= edit.dirty_from]
        self.pending = tuple(edit for edit in self.pending if edit not in settled)
        return [Outcome(self.key, edit.event_seq, Code.OK, edit.dirty_from) for edit in settled]

    # ---- windows ----------------------------------------------------------------------------------------------------

    def _replaceable_from(self, now: float, lead_s: float) -> int:
        """The first frame that the client cannot be showing lead_s from now, nor was promised; at most planned_to."""
        # Fewer frames than a patch make no history, and a window without history would start from the start pose.
        least = max(self.committed_to, self._unshown_from(now, lead_s), self.facts.patch)
        return min(least, self.planned_to)

    def _unshown_from(self, now: float, lead_s: float) -> int:
        """The first frame that the client cannot be showing lead_s from now."""
        # A client that reports frame f may be anywhere from f up to, not including, f + 1.
        return math.ceil(self.clock.estimate(now, self.sent_to) + self.facts.fps * lead_s) + 1

    def _history_at(self, frame: int) -> int:
        return min(self.config.history_crop, frame // self.facts.patch * self.facts.patch)

    def wake_at(self) -> float:
        """When the next window is due if nothing happens before; infinity if then, too, nothing happens."""
        frame = self.planned_to - self.continue_threshold
        waits = self.running is None and not self.pending and frame <= self.sent_to
        return self.clock.reaches_at(frame) if waits else math.inf

    def window_due(self, now: float) -> bool:
        """Whether a window is to be started: for an edit, or because the client will have played what there is."""
        if self.running is not None:
            return False
        unplayed = self.planned_to - self.clock.estimate(now, self.sent_to)
        short = self.planned_to == 0 or unplayed <= self.continue_threshold + _FRAME_TOLERANCE
        return bool(self.pending) or short

    def next_window(self, now: float, predicted_s: float, job_id: int) -> WindowJob:
        """Start the window that is due. predicted_s: how long it will take from now."""
        assert self.window_due(now)
        first_frame = self.planned_to
        cause = PlanCause.CONTINUE
        if self.pending:
            lead_s = max(predicted_s, self.extra_lead_s) + self.config.commit_s
            wanted = min(edit.dirty_from for edit in self.pending)
            first_frame = min(max(self._replaceable_from(now, lead_s), wanted), self.planned_to)
            cause = PlanCause.EDIT if self.planned_to else PlanCause.CONTINUE
        history = self._history_at(first_frame)
        end = first_frame + self.facts.horizon
        prompt = self.conditions.prompt_at(first_frame)
        job = WindowJob(
            job_id=job_id,
            session=self.key,
            plan=self.plan + 1,
            first_frame=first_frame,
            history=self.timeline.features_before(first_frame, history),
            start_pose=None if first_frame else self.spec.start_pose,
            embedding=None if prompt is None else prompt.embedding,
            constraints=self.conditions.constraints_within(
                first_frame, first_frame - history + self.facts.max_window_frames
            ),
            seed=self.spec.seed,
            num_steps=self.spec.denoise_steps,
            guidance=self.spec.guidance,
            deadline=self.deadline(now),
            priority=self.spec.priority,
            cause=cause,
            created_at=now,
        )
        accept_to = max(self.conditions.prompt_change_after(first_frame, end), self.facts.patch)
        self.running = RunningWindow(job, accept_to, self.pending, predicted_s)
        self.pending = ()
        return job

    def deadline(self, now: float) -> float:
        """When the window that is due is to be done: its class target after an edit came, or before frames run out."""
        if self.planned_to == 0:
            return self.opened_at + self.config.open_target_s
        if self.pending:
            return min(edit.received_at for edit in self.pending) + self.config.target_s(self.spec.priority)
        unplayed = self.planned_to - self.clock.estimate(now, self.sent_to)
        return now + unplayed / self.facts.fps - self.config.delivery_s

    def advance(self, steps_done: int) -> None:
        """Note how far the running window has come."""
        if self.running is not None:
            self.running = replace(self.running, steps_done=steps_done)

    def accept(self, result: WindowResult, now: float, report: StepReport) -> list[Output]:
        """Append the finished running window to the plan, or discard it where it came too late."""
        running = self.running
        assert running is not None
        assert running.job.job_id == result.job_id
        self._note_deadline(running, now, report)
        if running.first_frame < self._replaceable_from(now, self.config.delivery_s):
            self._withdraw(running)
            took = now - running.job.created_at
            self.extra_lead_s = max(took, 2 * self.extra_lead_s)
            report.windows_discarded += 1
            return []
        self.running = None
        num_frames = running.accept_to - running.first_frame
        self.timeline = self.timeline.spliced(
            running.first_frame, result.frames[:num_frames], result.features[:num_frames]
        )
        self.plan += 1
        self.restarts, self.extra_lead_s = 0, 0.0
        self.first_chunk_due = self.first_chunk_due or running.job.cause is PlanCause.EDIT
        report.windows.append((self.spec.priority, running.job.cause))
        report.frames_superseded += max(0, self.sent_to - running.first_frame)
        self.sent_to = min(self.sent_to, running.first_frame)
        self.unseen = [(edit, frame) for edit, frame in self.unseen if frame < self.sent_to]
        self.unseen += [(edit, max(edit.dirty_from, running.first_frame)) for edit in running.answers]
        return [self._notice(running), *self._answers(running), *self._settle()]

    def _note_deadline(self, running: RunningWindow, now: float, report: StepReport) -> None:
        report.deadlines.append(self.spec.priority)
        # A client that stands cannot run out of frames.
        counts = self.clock.running or running.job.cause is PlanCause.EDIT or self.planned_to == 0
        if counts and now > running.job.deadline:
            report.deadline_misses.append(self.spec.priority)

    def _notice(self, running: RunningWindow) -> PlanNotice:
        seqs = tuple(edit.event_seq for edit in running.answers)
        return PlanNotice(self.key, self.plan, running.first_frame, running.job.cause, seqs)

    def _answers(self, running: RunningWindow) -> list[Output]:
        return [
            Outcome(self.key, edit.event_seq, Code.OK, max(edit.dirty_from, running.first_frame))
            for edit in running.answers
        ]

    # ---- frames -----------------------------------------------------------------------------------------------------

    def emit(self, now: float, report: StepReport) -> list[Output]:
        """Send what the credit allows, in chunks: a short one first where a plan is new, then up to steady_chunk."""
        credit = self.clock.reported + self.spec.lookahead
        limit = min(self.planned_to, credit)
        if limit <= self.sent_to:
            return []
        due_to = math.ceil(self.clock.unheld(now)) if self.clock.running else 0
        self.clock.resume_from(self.sent_to, now)
        self._commit(now, limit)
        outputs: list[Output] = []
        while self.sent_to < limit:
            most = self.config.first_chunk if self.first_chunk_due else self.config.steady_chunk
            end = min(self.sent_to + most, limit)
            rows = self.timeline.rows_between(self.sent_to, end)
            outputs.append(Chunk(self.key, self.plan, self.sent_to, rows, self.committed_to))
            self.late_frames += max(0, min(due_to, end) - self.sent_to)
            self.first_chunk_due = False
            self.sent_to = end
        self._tally_sent(now, outputs, report)
        self._trim()
        return outputs

    def _commit(self, now: float, sent_to: int) -> None:
        """Promise the frames that no replan could change any more: those that it would reach too late."""
        promised = min(self._unshown_from(now, self.config.commit_s), sent_to)
        if self.running is not None:
            # The window that runs may still land here; a promise beyond its start would only make it void.
            promised = min(promised, self.running.first_frame)
        self.committed_to = max(self.committed_to, promised)

    def _tally_sent(self, now: float, chunks: Sequence[Output], report: StepReport) -> None:
        sent = sum(len(chunk.rows) for chunk in chunks if isinstance(chunk, Chunk))
        if self.num_frames == 0:
            report.event_latencies.append(EventLatency(self.spec.priority, "open", now - self.opened_at))
        self.num_frames = max(self.num_frames, self.sent_to)
        report.frames_sent += sent
        seen = [(edit, frame) for edit, frame in self.unseen if frame < self.sent_to]
        self.unseen = [pair for pair in self.unseen if pair not in seen]
        for edit, _ in seen:
            report.event_latencies.append(EventLatency(self.spec.priority, edit.kind, now - edit.received_at))

    def _trim(self) -> None:
        """Let go of what can neither be sent, nor replaced, nor be history; and of conditions that have passed."""
        keep_from = min(self.committed_to, self.sent_to) - self.config.history_crop
        if keep_from - self.timeline.first >= self.facts.horizon:
            self.timeline = self.timeline.trimmed(keep_from)
        self.conditions = self.conditions.without_past(self.committed_to)
