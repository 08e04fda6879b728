"""SessionState: one character's state, and its transitions: apply, next_window, accept, emit.

Transitions are deterministic in the state and their arguments; time comes in as `now`, nothing goes out but what they
return and what they tally in the StepReport. The rules:

- Frames below `committed_to` never change, and it never falls.
- A window starts at a commit frame, which the client cannot have played when the window lands, or at the end of the
  plan. One that lands too late is discarded, and its edits are tried again with a longer lead.
- All edits that wait when a window starts are answered by that window. One that arrives while a window runs cuts the
  window (a prompt that starts inside it), restarts it (less than half of its steps are done), or follows it.
- Each class has a most replans a second; edits in between wait and share one. They are answered however long it takes.
- A window is taken only up to the next change of prompt, so the window after it starts there with the new prompt.
- No frame is sent at or beyond the reported playhead + lookahead.
- A session told to hold makes no windows; it repeats its last pose when it would run out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from server.engine.conditions import Conditions, EditRefused
from server.engine.config import EngineConfig
from server.engine.drift import DriftGuard, Remedy
from server.engine.edits import EditEvent, EditQueue, PendingEdit, edited
from server.engine.ladder import FULL, Rung
from server.engine.playback import PlaybackClock, RoundTrip
from server.engine.pose import PoseReader
from server.engine.report import EventLatency, StepReport
from server.engine.timeline import Timeline
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
    ServiceLevel,
    SessionKey,
    SessionSpec,
    SetPlayState,
    SetPrompts,
    WindowJob,
    WindowResult,
)
from server.engine.windows import (
    RunningWindow,
    guidance_at,
    history_frames,
    history_of,
    no_history,
    root_before,
    steps_at,
    window_conditions,
)

# A wake-up computed in floating point may come a hair early; the tolerance keeps it from being asked for again.
_FRAME_TOLERANCE = 1e-3


@dataclass(slots=True)
class SessionState:
    """All that is known of a session. sent_to, committed_to: exclusive frame bounds; plan: the newest plan's number.

    remedy: what the next window is to right. holding: the newest plan repeats a pose.
    """

    spec: SessionSpec
    facts: ModelFacts
    config: EngineConfig
    guard: DriftGuard
    continue_threshold: int
    conditions: Conditions
    clock: PlaybackClock
    round_trip: RoundTrip
    timeline: Timeline
    edits: EditQueue
    opened_at: float
    last_playhead_at: float
    rung: Rung = FULL
    plan: int = 0
    sent_to: int = 0
    committed_to: int = 0
    running: RunningWindow | None = None
    remedy: Remedy | None = None
    holding: bool = False
    restarts: int = 0
    extra_lead_s: float = 0.0
    first_chunk_due: bool = True
    underruns: int = 0
    num_frames: int = 0
    late_frames: int = 0

    @property
    def key(self) -> SessionKey:
        return self.spec.session

    @property
    def planned_to(self) -> int:
        return self.timeline.end

    @property
    def num_steps(self) -> int:
        """Denoising steps of the next window."""
        return steps_at(self.rung, self.spec, self.facts)

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
            guard=DriftGuard(PoseReader.of(facts.rig), config),
            # A client that asks for a longer lookahead wants it filled.
            continue_threshold=max(config.continue_threshold, spec.lookahead - facts.horizon) + jitter,
            conditions=Conditions(spec.prompts, spec.constraints),
            clock=PlaybackClock(facts.fps),
            round_trip=RoundTrip(config.rtt_s),
            timeline=Timeline.empty(facts.row_width, facts.feature_dim, facts.token_width, facts.patch),
            edits=EditQueue(config.max_waiting_edits),
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
        waiting = (*(self.running.answers if self.running else ()), *self.edits.waiting)
        outputs: list[Output] = [
            Outcome(self.key, edit.event_seq, Code.CANCELLED, None, "SESSION_CLOSED", "the session closed before it")
            for edit in waiting
        ]
        self.running, self.edits.waiting = None, ()
        return [*outputs, Closed(self.key, reason, code, message, self.num_frames, self.late_frames)]

    def set_tier(self, rung: Rung) -> list[Output]:
        """Put the session on a rung of the ladder, from its next window on; tells the client what changes for it."""
        before = self.rung.tier, self.num_steps
        self.rung = rung
        level = rung.tier, self.num_steps
        return [] if level == before else [ServiceLevel(self.key, *level)]

    # ---- events -----------------------------------------------------------------------------------------------------

    def apply(self, event: EditEvent | Playhead | SetPlayState, now: float, report: StepReport) -> list[Output]:
        """Take in one event. If this ends the running window (`running` becomes None), its job is to be discarded."""
        if isinstance(event, Playhead):
            self._report_playhead(event, now, report)
            return []
        if isinstance(event, SetPlayState):
            self.clock.set_state(event.state, event.received_at, self.sent_to)
            return [Outcome(self.key, event.event_seq, Code.OK)]
        try:
            return self._edit(event, now, report)
        except EditRefused as refused:
            return [refused.outcome(self.key, event.event_seq)]

    def _report_playhead(self, event: Playhead, now: float, report: StepReport) -> None:
        self.last_playhead_at = now
        self.clock.report(event.frame, event.received_at, self.sent_to)
        self.round_trip.report(event.rtt_s, event.received_at)
        if event.underruns > self.underruns:
            report.client_underruns.append((self.spec.priority, event.underruns - self.underruns))
            self.underruns = event.underruns
        report.slacks.append((self.spec.priority, (event.buffered_to - event.frame) / self.facts.fps))

    def _edit(self, event: EditEvent, now: float, report: StepReport) -> list[Output]:
        self.edits.require_room()
        floor = self._replaceable_from(now, self._commit_s)
        reach = self.facts.max_window_frames - self._history_at(floor)
        self.conditions, kind, dirty_from = edited(self.conditions, event, floor, reach, self.config)
        if dirty_from is None:
            return [Outcome(self.key, event.event_seq, Code.OK)]
        if dirty_from > 0:
            dirty_from = max(dirty_from, self.timeline.motion_from + self.facts.patch)
        edit = PendingEdit(event.event_seq, kind, event.received_at, dirty_from)
        running = self.running
        if (
            running is not None
            and isinstance(event, SetPrompts)
            and running.first_frame < dirty_from < running.accept_to
            and dirty_from >= self._least_start(running)
        ):
            running.accept_to, running.answers = dirty_from, (*running.answers, edit)
            return []
        self.edits.add(edit)
        if running is not None and dirty_from < running.accept_to and self._worth_restarting(running):
            self._withdraw(running)
            self.restarts += 1
            report.windows_restarted += 1
        return self._settle()

    def _worth_restarting(self, running: RunningWindow) -> bool:
        early = running.steps_done * 2 < running.job.num_steps
        return early and self.restarts < self.config.max_restarts and not self.rung.full_stride

    def _withdraw(self, running: RunningWindow) -> None:
        """Forget the running window; its edits wait again."""
        self.edits.put_back(running.answers)
        self.remedy = running.remedy
        self.running = None

    def _settle(self) -> list[Output]:
        """Answer the edits that ask for frames which no window has touched yet: they will be there when it comes."""
        untouched_from = max(self.planned_to, self.running.accept_to if self.running else 0)
        settled = self.edits.settle(untouched_from)
        return [Outcome(self.key, edit.event_seq, Code.OK, edit.dirty_from) for edit in settled]

    # ---- leads ------------------------------------------------------------------------------------------------------

    @property
    def _delivery_s(self) -> float:
        """Seconds by which a notice sent now may trail what the client shows."""
        return self.round_trip.seconds + self.config.flush_s

    @property
    def _commit_s(self) -> float:
        """Seconds beyond the playhead that are promised not to change."""
        return self.round_trip.seconds + self.config.flush_s + self.config.margin_s

    def _replaceable_from(self, now: float, lead_s: float) -> int:
        """The first frame that the client cannot be showing lead_s from now, nor was promised; at most planned_to."""
        # Fewer frames than a patch make no history, and a window without history would start from the start pose.
        least = max(self.committed_to, self._unshown_from(now, lead_s), self.timeline.motion_from + self.facts.patch)
        return min(least, self.planned_to)

    def _unshown_from(self, now: float, lead_s: float) -> int:
        """The first frame that the client cannot be showing lead_s from now."""
        # A client that reports frame f may be anywhere from f up to, not including, f + 1.
        return math.ceil(self.clock.estimate(now, self.sent_to) + self.facts.fps * lead_s) + 1

    def _history_at(self, frame: int) -> int:
        return history_frames(frame, self.timeline, self.config, self.facts.patch)

    def _least_start(self, running: RunningWindow) -> int:
        """The first frame at which a window may follow the running one: there must be a patch of motion before it."""
        return (running.first_frame if running.fresh else self.timeline.motion_from) + self.facts.patch

    # ---- windows ----------------------------------------------------------------------------------------------------

    def wake_at(self) -> float:
        """When the session is to be looked at if nothing happens before; infinity if then, too, nothing happens."""
        if self.running is not None:
            return math.inf
        if self.rung.hold and self.planned_to:
            return self._reaches_unsent(self.planned_to - self._hold_lead)
        wake_at = self._reaches_unsent(self.planned_to - self.continue_threshold)
        return min(wake_at, self.edits.not_before) if self._replan_wanted else wake_at

    def _reaches_unsent(self, frame: int) -> float:
        # The estimate stops at sent_to: beyond it only an event can bring the session on.
        return self.clock.reaches_at(frame) if frame <= self.sent_to else math.inf

    @property
    def _replan_wanted(self) -> bool:
        return bool(self.edits.waiting) or self.remedy is Remedy.FRESH_START

    def window_due(self, now: float) -> bool:
        """Whether a window is to be started: for an edit, or because the client will have played what there is."""
        if self.running is not None:
            return False
        planned_to = self.timeline.end
        if planned_to == 0:
            return True
        if self.rung.hold:
            return False
        unplayed = planned_to - self.clock.estimate(now, self.sent_to)
        if unplayed <= self.continue_threshold + _FRAME_TOLERANCE:
            return True
        return self._replan_wanted and now >= self.edits.not_before

    def next_window(self, now: float, predicted_s: float, job_id: int) -> WindowJob:
        """Start the window that is due. predicted_s: how long it will take from now."""
        assert self.window_due(now)
        deadline = self.deadline(now)
        first_frame, cause = self._next_start(now, predicted_s)
        remedy, self.remedy = self.remedy, None
        facts, timeline = self.facts, self.timeline
        if first_frame == 0:
            history = no_history(facts, self.spec.start_pose)
        elif remedy is Remedy.FRESH_START:
            shown = timeline.rows_between(first_frame - 1, first_frame)
            history = no_history(facts, self.guard.fresh_start(shown[0]))
        else:
            history = history_of(first_frame, timeline, self.config, facts.patch, remedy)
        prompt = self.conditions.prompt_at(first_frame)
        root = root_before(first_frame, timeline, self.guard.reader, self.spec.start_pose, facts.fps)
        constraints = window_conditions(self.conditions, first_frame, len(history), root, facts)
        job = WindowJob(
            job_id=job_id,
            session=self.key,
            plan=self.plan + 1,
            first_frame=first_frame,
            history=history.features,
            start_pose=history.start_pose,
            embedding=None if prompt is None else prompt.embedding,
            constraints=constraints,
            seed=self.spec.seed,
            num_steps=self.num_steps,
            guidance=guidance_at(self.rung, self.spec.guidance, bool(constraints), facts),
            deadline=deadline,
            priority=self.spec.priority,
            cause=cause,
            created_at=now,
            history_tokens=history.tokens,
        )
        interval_s = 1.0 / (self.config.replans_hz[self.spec.priority - 1] * self.rung.replan_cap_scale)
        answers = self.edits.take(now, interval_s)
        if remedy is Remedy.FRESH_START:
            self.edits.not_before = now + interval_s
        self.running = RunningWindow(job, first_frame + facts.horizon, answers, self.conditions.velocity, remedy)
        change = self.conditions.prompt_change_after(first_frame, first_frame + facts.horizon)
        self.running.accept_to = max(change, self._least_start(self.running))
        return job

    def _next_start(self, now: float, predicted_s: float) -> tuple[int, PlanCause]:
        """The first frame of the window that is due, and why it is made."""
        planned_to = self.planned_to
        if planned_to == 0 or not self._replan_wanted:
            return planned_to, PlanCause.CONTINUE if self.remedy is None else PlanCause.FALLBACK
        lead_s = max(predicted_s, self.extra_lead_s) + self._commit_s
        earliest = self._replaceable_from(now, lead_s)
        wanted = min((edit.dirty_from for edit in self.edits.waiting), default=earliest)
        if wanted > earliest:
            return min(wanted, planned_to), PlanCause.EDIT
        if self.config.align_replans:
            earliest = min(earliest + (self.timeline.run.first - earliest) % self.facts.patch, planned_to)
        return earliest, PlanCause.EDIT if self.edits.waiting else PlanCause.FALLBACK

    def deadline(self, now: float) -> float:
        """When the window that is due is to be done: its class target after an edit may be answered, or before frames
        run out."""
        if self.planned_to == 0:
            return self.opened_at + self.config.open_target_s
        if self.edits.waiting:
            asked_at = max(min(edit.received_at for edit in self.edits.waiting), self.edits.not_before)
            return asked_at + self.config.target_s(self.spec.priority)
        unplayed = self.planned_to - self.clock.estimate(now, self.sent_to)
        return now + unplayed / self.facts.fps - self._delivery_s

    def advance(self, steps_done: int) -> None:
        """Note how far the running window has come."""
        if self.running is not None:
            self.running.steps_done = steps_done

    def accept(self, result: WindowResult, now: float, report: StepReport) -> list[Output]:
        """Append the finished running window to the plan, or discard it where it came too late."""
        running = self.running
        assert running is not None
        assert running.job.job_id == result.job_id
        self._note_deadline(running, now, report)
        if running.first_frame < self._replaceable_from(now, self._delivery_s):
            self._withdraw(running)
            self.extra_lead_s = max(now - running.job.created_at, 2 * self.extra_lead_s)
            report.windows_discarded += 1
            return []
        self.running = None
        first_frame, num_frames = running.first_frame, running.accept_to - running.first_frame
        rows = result.frames[:num_frames]
        self.timeline = self.timeline.spliced(
            first_frame, rows, result.features[:num_frames], result.tokens, anew=running.fresh
        )
        self.plan += 1
        self.holding = False
        self.restarts, self.extra_lead_s = 0, 0.0
        self.remedy = self.guard.remedy(rows)
        self._start_velocity(running)
        self.first_chunk_due = self.first_chunk_due or running.job.cause is PlanCause.EDIT
        report.windows.append((self.spec.priority, running.job.cause))
        report.soft_resets += running.remedy is not None
        report.frames_superseded += max(0, self.sent_to - first_frame)
        self.sent_to = min(self.sent_to, first_frame)
        answered = self.edits.landed(running.answers, first_frame, self.sent_to)
        seqs = tuple(edit.event_seq for edit, _ in answered)
        return [
            PlanNotice(self.key, self.plan, first_frame, running.job.cause, seqs),
            *(Outcome(self.key, edit.event_seq, Code.OK, frame) for edit, frame in answered),
            *self._settle(),
        ]

    def _start_velocity(self, running: RunningWindow) -> None:
        """The time that a velocity holds begins with the first window that obeys it."""
        velocity = self.conditions.velocity
        if velocity is not None and velocity.steers_from is None and velocity is running.velocity:
            self.conditions = self.conditions.with_velocity_from(running.first_frame)

    def _note_deadline(self, running: RunningWindow, now: float, report: StepReport) -> None:
        report.deadlines.append(self.spec.priority)
        # A client that stands cannot run out of frames.
        counts = self.clock.running or running.job.cause is PlanCause.EDIT or self.planned_to == 0
        if counts and now > running.job.deadline:
            report.deadline_misses.append(self.spec.priority)

    # ---- frames -----------------------------------------------------------------------------------------------------

    def emit(self, now: float, report: StepReport) -> list[Output]:
        """Send what the credit allows, in chunks: a short one first where a plan is new, then up to steady_chunk."""
        outputs = self._hold(now, report) if self.rung.hold else []
        limit = min(self.timeline.end, self.clock.reported + self.spec.lookahead)
        if limit <= self.sent_to:
            return outputs
        due_to = math.ceil(self.clock.unheld(now)) if self.clock.running else 0
        self.clock.resume_from(self.sent_to, now)
        self._commit(now, limit)
        begun_at = self.sent_to
        while self.sent_to < limit:
            most = self.config.first_chunk if self.first_chunk_due else self.config.steady_chunk
            end = min(self.sent_to + most, limit)
            rows = self.timeline.rows_between(self.sent_to, end)
            outputs.append(Chunk(self.key, self.plan, self.sent_to, rows, self.committed_to))
            self.first_chunk_due = False
            self.sent_to = end
        self.late_frames += max(0, min(due_to, limit) - begun_at)
        self._tally_sent(now, limit - begun_at, report)
        self._trim()
        return outputs

    @property
    def _hold_lead(self) -> int:
        """Unplayed frames at which a held pose must be sent for the client not to run out."""
        return math.ceil(self.facts.fps * self._commit_s) + 1

    def _hold(self, now: float, report: StepReport) -> list[Output]:
        """Repeat the last pose where the client would run out and no window may be made for it."""
        if self.running is not None or self.planned_to == 0 or not self.clock.running:
            return []
        unplayed = self.planned_to - self.clock.estimate(now, self.sent_to)
        if unplayed > self._hold_lead + _FRAME_TOLERANCE:
            return []
        held_from, num_frames = self.planned_to, self.config.hold_frames
        self.timeline = self.timeline.held(num_frames)
        self.committed_to = self.planned_to
        report.frames_held += num_frames
        if self.holding:
            return []
        self.plan += 1
        self.holding = True
        return [PlanNotice(self.key, self.plan, held_from, PlanCause.FALLBACK, ())]

    def _commit(self, now: float, sent_to: int) -> None:
        """Promise the frames that no replan could change any more: those that it would reach too late."""
        promised = min(self._unshown_from(now, self._commit_s), sent_to)
        if self.running is not None:
            # The window that runs may still land here; a promise beyond its start would only make it void.
            promised = min(promised, self.running.first_frame)
        self.committed_to = max(self.committed_to, promised)

    def _tally_sent(self, now: float, num_frames: int, report: StepReport) -> None:
        if self.num_frames == 0:
            report.event_latencies.append(EventLatency(self.spec.priority, "open", now - self.opened_at))
        self.num_frames = max(self.num_frames, self.sent_to)
        report.frames_sent += num_frames
        for edit in self.edits.seen(self.sent_to):
            report.event_latencies.append(EventLatency(self.spec.priority, edit.kind, now - edit.received_at))

    def _trim(self) -> None:
        """Let go of what can neither be sent, nor replaced, nor be history; and of conditions that have passed."""
        keep_from = min(self.committed_to, self.sent_to) - self.config.history_crop
        if keep_from - self.timeline.first >= self.facts.horizon:
            self.timeline = self.timeline.trimmed(keep_from)
        self.conditions = self.conditions.without_past(self.committed_to)
