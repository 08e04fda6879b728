"""SessionState: one character's state, and its transitions: apply, next_window, accept, emit.

Transitions are deterministic in the state and their arguments; time comes in as `now`, nothing goes out but what they
return and what they count in the StepReport. The rules:

- Frames below `committed_to` never change, and it never falls.
- A window starts at a commit frame, which the client cannot have played when the window lands, or at the end of the
  plan. One that lands too late is discarded, and its edits are tried again with a longer lead.
- All edits that wait when a window starts are answered by that window. One that arrives while a window runs cuts the
  window (a prompt that starts inside it), joins it (it has not begun), restarts it (it answers no edit, and less than
  half of its steps are done), or follows it.
- Each class has a most replans a second; edits in between wait and share one. They are answered however long it takes.
- A window is taken only up to the next change of prompt, so the window after it starts there with the new prompt.
- No frame is sent at or beyond the playhead + lookahead, of which the playhead runs at real time and little more.
- A constraint is answered when its last frame is committed: met or missed, and by how much.
- A session told to hold makes no windows; it repeats its last pose when it would run out.
- A clip is not played: windows follow one another until its frames are there, and each is sent when it lands; no more
  than its lookahead beyond what its client has taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.degradation import FULL, Level
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.delivery import Delivery
from motiongen_server.engine.session.drift import DriftState
from motiongen_server.engine.session.edits import EditEvent, EditQueue, PendingEdit, edited
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.session.playback import PlaybackClock
from motiongen_server.engine.session.reach import ReachWatch
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.session.windows import RunningWindow, WindowSite, history_crop, history_frames, steps_at
from motiongen_server.engine.types import (
    Closed,
    CloseReason,
    Code,
    EventRefused,
    ModelFacts,
    Opened,
    Outcome,
    Output,
    Placement,
    PlanCause,
    PlanNotice,
    Playhead,
    PlayState,
    Resume,
    ServiceLevel,
    SessionKey,
    SessionSpec,
    SetPlayState,
    SetPrompts,
    WindowJob,
    WindowResult,
)
from motiongen_server.engine.types.refusals import session_closed
from motiongen_server.engine.types.report import EventLatency, StepReport

# A wake-up computed in floating point may come a hair early; the tolerance keeps it from being asked for again.
_FRAME_TOLERANCE = 1e-3


@dataclass(slots=True)
class SessionState:
    """All that is known of a session. plan: the newest plan's number; holding: it repeats a pose.

    cut_frames: by which the first window that is made while the client plays is cut, so that sessions spread out.
    restarts, extra_lead_s: of windows in a row that did not land. predicted_s: how long the last one was to take.
    placements: of the constraints that it was opened with.
    """

    spec: SessionSpec
    facts: ModelFacts
    config: EngineConfig
    continue_threshold: int
    cut_frames: int
    conditions: Conditions
    delivery: Delivery
    timeline: Timeline
    edits: EditQueue
    drift_state: DriftState
    reach: ReachWatch
    opened_at: float
    last_playhead_at: float
    moved_at: float
    level: Level = FULL
    plan: int = 0
    running: RunningWindow | None = None
    holding: bool = False
    restarts: int = 0
    extra_lead_s: float = 0.0
    predicted_s: float = 0.0
    underruns: int = 0
    placements: tuple[Placement, ...] = ()

    @property
    def key(self) -> SessionKey:
        return self.spec.session

    @property
    def planned_to(self) -> int:
        return self.timeline.end

    @property
    def clock(self) -> PlaybackClock:
        return self.delivery.clock

    @property
    def complete(self) -> bool:
        """Whether it is a clip that was sent to its last frame."""
        return self.spec.clip_frames is not None and self.delivery.sent_to >= self.spec.clip_frames

    @property
    def num_steps(self) -> int:
        """Denoising steps of the next window."""
        return steps_at(self.level, self.spec, self.facts)

    # ---- opening and closing ----------------------------------------------------------------------------------------

    def greeting(self) -> Opened:
        return Opened(
            self.key,
            self.spec.seed,
            start_frame=0,
            lookahead=self.spec.lookahead,
            committed_horizon=math.ceil(self.facts.fps * self.config.commit_s) + 1,
            denoise_steps=self.spec.denoise_steps,
            model_id=self.facts.model_id,
            rig_id=self.facts.rig.rig_id,
            fps=self.facts.fps,
            placements=self.placements,
        )

    def close(self, reason: CloseReason, code: Code, message: str) -> list[Output]:
        """Answer every edit that still waits, then say goodbye. The session must not be used again."""
        waiting = (*(self.running.answers if self.running else ()), *self.edits.waiting)
        outputs: list[Output] = [session_closed().outcome(self.key, edit.event_seq) for edit in waiting]
        self.running, self.edits.waiting = None, ()
        return [*outputs, Closed(self.key, reason, code, message, self.delivery.num_frames, self.delivery.late_frames)]

    def set_tier(self, level: Level) -> list[Output]:
        """Put the session on a level of service, from its next window on; tells the client what changes for it."""
        before = self.level.tier, self.num_steps
        self.level = level
        given = level.tier, self.num_steps
        return [] if given == before else [ServiceLevel(self.key, *given)]

    # ---- events -----------------------------------------------------------------------------------------------------

    def apply(
        self, event: EditEvent | Playhead | SetPlayState | Resume, now: float, report: StepReport
    ) -> list[Output]:
        """Take in one event. If this ends the running window (`running` becomes None), its job is to be discarded."""
        if isinstance(event, Playhead):
            self._report_playhead(event, now, report)
            return []
        if isinstance(event, Resume):
            self.last_playhead_at = self.moved_at = now
            return self.delivery.resume(event, self.plan, self.timeline.first)
        if isinstance(event, SetPlayState):
            self.moved_at = now
            self.clock.set_state(event.state, event.received_at, self.delivery.sent_to)
            return [Outcome(self.key, event.event_seq, Code.OK)]
        try:
            return self._edit(event, now, report)
        except EventRefused as refused:
            return [refused.outcome(self.key, event.event_seq)]

    def _report_playhead(self, event: Playhead, now: float, report: StepReport) -> None:
        if self.spec.clip_frames is not None:
            self.delivery.grant(min(event.frame, self.spec.clip_frames - self.spec.lookahead))
            return
        clock, reported = self.clock, self.clock.reported
        # One in every frame at most, whatever the client counts.
        most = math.ceil((now - self.last_playhead_at) * self.facts.fps) + 1
        if event.underruns > self.underruns:
            report.client_underruns.append((self.spec.priority, min(event.underruns - self.underruns, most)))
            self.underruns = event.underruns
        self.delivery.report(event)
        self.last_playhead_at = now
        if clock.reported > reported:
            self.moved_at = now
        held = min(event.buffered_to, self.delivery.sent_to) - event.frame
        report.slacks.append((self.spec.priority, max(0, held) / self.facts.fps))

    @property
    def idle_at(self) -> float:
        """When the session is to be closed if its playhead neither is reported nor moves until then."""
        config = self.config
        still_s = config.idle_timeout_s if self.clock.state is PlayState.PLAYING else config.still_timeout_s
        return min(self.last_playhead_at + config.idle_timeout_s, self.moved_at + still_s)

    def _edit(self, event: EditEvent, now: float, report: StepReport) -> list[Output]:
        self.edits.require_room()
        floor = self._replaceable_from(now, self.delivery.commit_s)
        crop = history_crop(self.spec, self.config)
        reach = self.facts.max_window_frames - history_frames(floor, self.timeline, crop, self.facts.patch)
        anchor = self._anchor(now)
        self.conditions, kind, dirty_from, placements = edited(
            self.conditions, event, floor, reach, self.config, anchor, self.spec.gaits
        )
        if dirty_from is None:
            return [Outcome(self.key, event.event_seq, Code.OK, placements=placements)]
        if dirty_from > 0:
            dirty_from = max(dirty_from, self.timeline.motion_from + self.facts.patch)
        edit = PendingEdit(event.event_seq, kind, event.received_at, dirty_from, placements)
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
            self.restarts += running.steps_done > 0
            report.windows_restarted += running.steps_done > 0
            self._withdraw(running, report)
        return self._settle()

    def _worth_restarting(self, running: RunningWindow) -> bool:
        """Whether to begin a window again for an edit that came meanwhile, rather than let another one follow it.

        One that has not begun costs nothing. One that answers edits is finished: these were first, and more may come.
        """
        if not running.steps_done:
            return True
        early = running.steps_done * 2 < running.job.num_steps
        return early and not running.answers and self.restarts < self.config.max_restarts and not self.level.full_stride

    def _withdraw(self, running: RunningWindow, report: StepReport) -> None:
        """Forget the running window; its edits wait again."""
        report.steps_discarded += running.steps_done
        self.edits.put_back(running.answers)
        self.drift_state.correction = running.correction
        self.running = None

    def _settle(self) -> list[Output]:
        """Answer the edits that ask for frames which no window has touched yet: they will be there when it comes."""
        if self.level.hold:
            return []  # it may hold its pose right over those frames
        untouched_from = max(self.planned_to, self.running.accept_to if self.running else 0)
        settled = self.edits.settle(untouched_from)
        return [edit.done(self.key, edit.dirty_from) for edit in settled]

    def _anchor(self, now: float) -> Anchor:
        """Where the character will be when an edit of now takes effect: where the window for it is likely to start."""
        frame = self._replaceable_from(now, max(self.predicted_s, self.extra_lead_s) + self.delivery.commit_s)
        return Anchor(frame, self._site().root_before(frame), self.facts.fps)

    # ---- leads ------------------------------------------------------------------------------------------------------

    def _replaceable_from(self, now: float, lead_s: float) -> int:
        """The first frame that the client cannot be showing lead_s from now, nor was promised; at most planned_to."""
        delivery = self.delivery
        # Fewer frames than a patch make no history, and a window without history would start from the start pose.
        least = self.timeline.motion_from + self.facts.patch
        return min(max(delivery.committed_to, delivery.unshown_from(now, lead_s), least), self.planned_to)

    def _least_start(self, running: RunningWindow) -> int:
        """The first frame at which a window may follow the running one: there must be a patch of motion before it."""
        return (running.first_frame if running.fresh else self.timeline.motion_from) + self.facts.patch

    # ---- windows ----------------------------------------------------------------------------------------------------

    def wake_at(self) -> float:
        """When the session is to be looked at if nothing happens before; infinity if then, too, nothing happens."""
        if self.running is not None or self.spec.is_clip:
            return math.inf
        planned_to, delivery = self.timeline.end, self.delivery
        if self.level.hold and planned_to:
            return delivery.reaches_at(planned_to - delivery.commit_frames)
        wake_at = delivery.reaches_at(planned_to - self.continue_threshold - delivery.far_frames)
        return min(wake_at, self.edits.not_before) if self._replan_wanted else wake_at

    @property
    def _replan_wanted(self) -> bool:
        return bool(self.edits.waiting) or self.drift_state.lost

    def window_due(self, now: float) -> bool:
        """Whether a window is to be started: for an edit, or because the client will have played what there is."""
        if self.running is not None:
            return False
        planned_to = self.timeline.end
        if self.spec.clip_frames is not None:
            return planned_to < min(self.spec.clip_frames, self.clock.credited + self.spec.lookahead)
        if planned_to == 0:
            return True
        if self.level.hold:
            return False
        delivery = self.delivery
        enough = self.continue_threshold + delivery.far_frames
        if delivery.unplayed(now, planned_to) <= enough + _FRAME_TOLERANCE:
            return True
        return self._replan_wanted and now >= self.edits.not_before

    def next_window(self, now: float, predicted_s: float, job_id: int) -> WindowJob:
        """Start the window that is due. predicted_s: how long it will take from now."""
        assert self.window_due(now)
        first_frame, cause = self._next_start(now, predicted_s)
        site, self.predicted_s = self._site(), predicted_s
        correction = self.drift_state.correction_from(first_frame)
        job = site.job(first_frame, correction, job_id, self.plan + 1, cause, now, self.deadline(now))
        if self._replan_wanted:
            replans_hz = self.config.replans_hz[self.spec.priority - 1] * self.level.replan_cap_scale
            self.edits.space_replans(now, replans_hz)
        end = first_frame + self.facts.horizon
        if cause is PlanCause.CONTINUE and self.clock.running:
            end, self.cut_frames = end - self.cut_frames, 0
        self.running = RunningWindow(job, end, self.edits.take(), self.conditions.velocity, self.drift_state.correction)
        change = self.conditions.prompt_change_after(first_frame, end)
        self.running.accept_to = max(change, self._least_start(self.running))
        self.drift_state.correction = None
        return job

    def _site(self) -> WindowSite:
        guard, level = self.drift_state.guard, self.level
        return WindowSite(self.spec, self.facts, self.config, guard, level, self.conditions, self.timeline)

    def _next_start(self, now: float, predicted_s: float) -> tuple[int, PlanCause]:
        """The first frame of the window that is due, and why it is made."""
        planned_to = self.planned_to
        if planned_to == 0 or not self._replan_wanted:
            return planned_to, PlanCause.CONTINUE if self.drift_state.correction is None else PlanCause.FALLBACK
        lead_s = max(predicted_s, self.extra_lead_s) + self.delivery.commit_s
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
        if self.spec.is_clip:
            return self.opened_at + self.config.clip_target_s
        if self.planned_to == 0:
            return self.opened_at + self.config.open_target_s
        if self.edits.waiting:
            asked_at = max(min(edit.received_at for edit in self.edits.waiting), self.edits.not_before)
            return asked_at + self.config.target_s(self.spec.priority)
        unplayed = self.delivery.unplayed_at_pace(now, self.planned_to)
        return now + unplayed / self.facts.fps - self.delivery.delivery_s

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
        if running.first_frame < self._replaceable_from(now, self.delivery.delivery_s):
            self._withdraw(running, report)
            self.extra_lead_s = max(now - running.job.created_at, 2 * self.extra_lead_s)
            report.windows_discarded += 1
            return []
        self.running = None
        first_frame, num_frames = running.first_frame, running.accept_to - running.first_frame
        # A runner may give fewer: from the next frame on it would tell the model something else.
        rows = result.frames[:num_frames]
        self.timeline = self.timeline.spliced(
            first_frame, rows, result.features[:num_frames], result.tokens, anew=running.fresh
        )
        self.plan += 1
        self.holding = False
        self.restarts, self.extra_lead_s = 0, 0.0
        self.drift_state.judge(rows, first_frame)
        self.conditions = self.conditions.with_velocity_landed(running.velocity, first_frame)
        self.delivery.first_chunk_due |= running.job.cause is PlanCause.EDIT
        report.windows.append((self.spec.priority, running.job.cause))
        report.soft_resets += running.correction is not None
        sent_to = self.delivery.sent_to
        report.frames_superseded += self.delivery.superseded(first_frame)
        answered = self.edits.landed(running.answers, first_frame, self.delivery.sent_to)
        seqs = tuple(edit.event_seq for edit, _ in answered)
        notice = PlanNotice(self.key, self.plan, first_frame, running.job.cause, seqs)
        self.delivery.plan_log.note(notice, sent_to)
        return [
            notice,
            *(edit.done(self.key, frame) for edit, frame in answered),
            *self._settle(),
        ]

    def _note_deadline(self, running: RunningWindow, now: float, report: StepReport) -> None:
        if self.spec.is_clip:
            return
        report.deadlines.append(self.spec.priority)
        # A client that stands cannot run out of frames.
        counts = self.clock.running or running.job.cause is PlanCause.EDIT or self.planned_to == 0
        if counts and now > running.job.deadline:
            report.deadline_misses.append(self.spec.priority)

    # ---- frames -----------------------------------------------------------------------------------------------------

    def emit(self, now: float, report: StepReport) -> list[Output]:
        """Send what the credit allows."""
        outputs: list[Output] = self._hold(now, report) if self.level.hold else []
        if self.spec.is_clip:
            self.delivery.promise(self.planned_to)
        # The window that runs may still land where it starts; a promise beyond that would only make it void.
        promise_to = math.inf if self.running is None else self.running.first_frame
        sent_before = self.delivery.sent_to
        opening = self.delivery.num_frames == 0
        chunks = self.delivery.chunks(now, self.timeline, self.plan, promise_to)
        if not chunks:
            return outputs
        outputs += chunks
        told = self.reach.reached(self.facts.rig, self.conditions, self.timeline, self.delivery.committed_to)
        if told:
            self.conditions = self.conditions.without_told([constraint for constraint, _ in told])
            outputs += [reached for _, reached in told]
        report.frames_sent += self.delivery.sent_to - sent_before
        if opening:
            report.event_latencies.append(EventLatency(self.spec.priority, "open", now - self.opened_at))
        for edit in self.edits.seen(self.delivery.sent_to):
            report.event_latencies.append(EventLatency(self.spec.priority, edit.kind, now - edit.received_at))
        self._trim()
        return outputs

    def _hold(self, now: float, report: StepReport) -> list[Output]:
        """Repeat the last pose where the client would run out and no window may be made for it."""
        held_from, delivery = self.planned_to, self.delivery
        if self.running is not None or held_from == 0 or not self.clock.running:
            return []
        if delivery.unplayed(now, held_from) > delivery.commit_frames + _FRAME_TOLERANCE:
            return []
        self.timeline = self.timeline.held(self.config.hold_frames)
        delivery.promise(self.planned_to)
        report.frames_held += self.config.hold_frames
        if self.holding:
            return []
        self.plan += 1
        self.holding = True
        notice = PlanNotice(self.key, self.plan, held_from, PlanCause.FALLBACK, ())
        delivery.plan_log.note(notice, delivery.sent_to)
        return [notice]

    def _trim(self) -> None:
        """Let go of what can neither be sent, nor replaced, nor be history; and of conditions that have passed."""
        committed_to = self.delivery.committed_to
        # A client that loses its transport may have to be sent again all that lies beyond its last report.
        missed_from = math.inf if self.spec.is_clip else self.clock.reported
        keep_from = int(min(committed_to, self.delivery.sent_to, missed_from)) - history_crop(self.spec, self.config)
        if keep_from - self.timeline.first >= self.facts.horizon:
            self.timeline = self.timeline.trimmed(keep_from)
        self.conditions = self.conditions.without_past(committed_to)
