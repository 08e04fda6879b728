"""Engine: takes events, schedules windows, steps the runner and delivers outputs; `loop` calls it round after round."""

from __future__ import annotations

import itertools
from math import inf

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.intake import Intake
from motiongen_server.engine.load_response import LoadResponse
from motiongen_server.engine.mailbox import Mailbox
from motiongen_server.engine.newest_owners import NewestOwners
from motiongen_server.engine.open_sessions import OpenSessions
from motiongen_server.engine.ports import Clock, Deliver, Inbox, Observe, Runner
from motiongen_server.engine.running_windows import RunningWindows
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.device import Device, DeviceLease
from motiongen_server.engine.scheduling.load_monitor import LoadMonitor
from motiongen_server.engine.scheduling.policy import SchedulingPolicy
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.session import emission
from motiongen_server.engine.session.beginning import begun, first_words
from motiongen_server.engine.session.further_blocks import OutputsFailed
from motiongen_server.engine.session.opening import Opening
from motiongen_server.engine.session.snapshot import news_of
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.session_events import SessionEvents
from motiongen_server.engine.types import (
    UNTOLD,
    Close,
    CloseReason,
    Code,
    Event,
    EventRefused,
    Open,
    Outcome,
    Output,
    Priority,
)
from motiongen_server.engine.types.refusals import handle_in_use, session_not_open
from motiongen_server.engine.types.report import StepReport

_IDLE_TICK_S = 0.5  # the longest sleep, so that the heartbeat stays fresh


class Engine:
    """Generates the motion of all sessions with one runner.

    Members in the section "from any thread", and `intake`, may be used from any thread, all others only from the one
    that calls `step`, as it calls `deliver`. sessions, windows, admission: the current state. observe: gets every
    report.
    """

    def __init__(
        self,
        runner: Runner,
        clock: Clock,
        deliver: Deliver,
        config: EngineConfig,
        *,
        observe: Observe | None = None,
        inbox: Inbox | None = None,
        scheduler: SchedulingPolicy | None = None,
        lease: DeviceLease | None = None,
    ) -> None:
        """inbox: where events come from, instead of `submit` alone. scheduler: a policy in place of `Scheduler`.

        lease: this engine's place at a device that other engines use too; `loop.run` gives it up at the end. Raises
        ValueError if the configuration does not fit the runner's model.
        """
        config.check_against(runner.facts)
        now = clock.now()
        self._facts = runner.facts
        self._clock = clock
        self._deliver = deliver
        self.observe = observe
        self._config = config
        self._mailbox: Inbox = Mailbox(config.max_pending_events) if inbox is None else inbox
        self.lease = Device().lease() if lease is None else lease
        under_quota = self.lease.quota is not None
        if scheduler is None:  # not `or`: a policy that holds no jobs yet is falsy
            costs = CostTable.assumed(config.initial_step_s)
            scheduler = Scheduler(costs, config.max_rows, max_step_s=config.max_step_s, under_quota=under_quota)
        self.admission = Admission(runner.facts, config, under_quota=under_quota)
        self._load_monitor = LoadMonitor(runner.facts, self.admission, now, config.degrade, self.lease)
        self.sessions = OpenSessions()
        self.windows = RunningWindows(
            runner, clock, scheduler, self.lease, max_rows=config.max_rows, failed=self._fail, trace_as=config.trace_as
        )
        self._owners = NewestOwners(self.admission, self.sessions)
        most_pending, quotas = config.max_pending_events, self.windows.quotas
        self.intake = Intake(self.admission, self._mailbox, most_pending, quotas, self._owners)
        self._session_events = SessionEvents(self.admission, self.sessions, self.windows, self._load_monitor)
        self._load_response = LoadResponse(self._load_monitor, self.windows, self.sessions)
        self._ordinals = itertools.count()
        self._send_queue: list[Output] = []
        self._report = StepReport()
        self._heartbeat_at = now
        self._stopping = False
        self._measure(now)

    # ---- from any thread --------------------------------------------------------------------------------------------

    @property
    def num_sessions(self) -> int:
        return len(self.sessions)

    @property
    def heartbeat_at(self) -> float:
        """When the loop last began a round, on the engine's clock; less than a second ago while the engine is well."""
        return self._heartbeat_at

    @property
    def free_share(self) -> float:
        """The share of the capacity for sessions that is left for new ones, 0 to 1."""
        return self.admission.free_share

    def submit(self, event: Event) -> Outcome | None:
        """Hand in an event. Returns its outcome if it is refused at once; other answers come through `deliver`."""
        return self.intake.submit(event)

    def refusal_of(self, priority: Priority, denoise_steps: int, *, is_clip: bool = False) -> EventRefused | None:
        """Why a session would be refused at present, None if it would be admitted; reserves nothing."""
        return self.admission.refusal_of(priority, denoise_steps, is_clip=is_clip)

    def drain(self) -> None:
        """Take no new sessions; open ones continue."""
        self.admission.close()

    def stop(self) -> None:
        """Start no new windows, finish the running ones, close every session as DRAINED, and end the loop."""
        self.admission.close()
        self._stopping = True
        self._mailbox.ring()

    # ---- the loop ---------------------------------------------------------------------------------------------------

    @property
    def finished(self) -> bool:
        """Whether the engine was stopped and has no window left."""
        return self._stopping and not len(self.windows)

    def step(self) -> StepReport:
        """One round: events in, one denoising step for the most urgent rows, finished windows out."""
        self._report = report = StepReport()
        self._heartbeat_at = now = self._clock.now()
        self._take_events()
        self._owners.apply()
        self.sessions.touch_due(now)
        self._close_silent(now)
        self._attend_touched()
        if finished := self.windows.step(report):
            self._take_in(finished)
        self._attend_touched()
        now = self._clock.now()
        if now >= self._load_monitor.due_at:
            self._measure(now)
            self._flush()
        report.opens += self.admission.take_refused().elements()
        report.sessions = self.sessions.take_counts()
        report.quota_steps = self.windows.quotas.take_taken(now)
        return report

    def idle_s(self) -> float:
        """How long the loop may sleep if no event arrives."""
        wake_at = min(self.sessions.next_at(), self.windows.wake_at())
        return min(_IDLE_TICK_S, max(0.0, wake_at - self._clock.now()))

    def wait(self) -> None:
        """Sleep until an event arrives or something is due; after `stop` only while windows are held back."""
        if not self._stopping or self.windows.wake_at() < inf:
            self._mailbox.wait(self.idle_s())

    def end_drained(self) -> None:
        """Close every session because the server is shutting down."""
        self._take_events()
        self._close_all(CloseReason.DRAINED, Code.UNAVAILABLE, "the server is going away; open a session elsewhere")

    def end_failed(self) -> None:
        """Close every session because the engine itself failed, and take no new ones."""
        self.admission.close()
        self._close_all(CloseReason.ENGINE_FAULT, Code.INTERNAL, "the server's engine failed; open a new session")

    # ---- events and sessions ----------------------------------------------------------------------------------------

    def _take_events(self) -> None:
        now = self._clock.now()
        for event in self._mailbox.take_all():
            state = self.sessions.get(event.session)
            if isinstance(event, Open):
                self._open(event, state)
            elif state is None:
                if not isinstance(event, UNTOLD):
                    self._refuse(event, session_not_open(event.session.handle))
            elif isinstance(event, Close):
                self._close(state, event.reason, Code.OK, "")
            else:
                self._send_queue += self._session_events.take(state, event, now, self._report)

    def _open(self, event: Open, held: SessionState | None) -> None:
        if held is not None:
            self._report.opens.append(self._refuse(event, handle_in_use(event.session.handle)))
            return
        refusal = self.admission.reserve(event.spec, event.event_seq)
        if refusal is not None:
            self._send_queue.append(refusal)
            return
        spec, now = event.spec, self._clock.now()
        try:
            opening = Opening(next(self._ordinals), self._facts, self._config, now)
            state = begun(event, opening, self.windows.features)
        except EventRefused as failed:
            self.admission.release(spec.session, spec)
            self._report.opens.append(self._refuse(event, failed))
            return
        self.sessions.add(state)
        self._owners.renew(state)
        if event.going_on is not None:  # its first window was made by another engine
            self.admission.note_begun(state.key)
        self._send_queue += first_words(state, event, now, self._report)
        self._report.opens.append(Code.OK)
        if spec.is_clip:  # never degraded, and its client reports nothing until it ends
            return
        self.sessions.watch_silence(state, now + self._config.idle_timeout_s)
        self._send_queue += state.set_tier(self._load_monitor.level(spec.priority).of_newcomers)

    def _refuse(self, event: Event, refusal: EventRefused) -> Code:
        """Answer an event that reaches no session."""
        self._send_queue.append(refusal.outcome(event.session, event.event_seq))
        return refusal.code

    def _close(self, state: SessionState, reason: CloseReason, code: Code, message: str) -> None:
        if state.running is not None:
            self.windows.discard(state.running.job.job_id)
        self._send_queue += state.close(reason, code, message)
        self._report.closes.append(reason)
        self.sessions.remove(state)
        self.admission.release(state.key, state.spec)

    def _close_all(self, reason: CloseReason, code: Code, message: str) -> None:
        for state in list(self.sessions):
            self._close(state, reason, code, message)
        self._flush()

    def _close_silent(self, now: float) -> None:
        limit = self._config.idle_timeout_s
        for state in self.sessions.fallen_silent(now):
            if now >= state.idle_at:
                message = f"no Playhead for {limit:g} s, or none that moved; report the frame shown at least that often"
                self._close(state, CloseReason.IDLE, Code.OK, message)
            else:
                self.sessions.watch_silence(state, state.idle_at)

    def _attend_touched(self) -> None:
        """Send what the touched sessions have ready, start the windows that are due, and deliver."""
        now = self._clock.now()
        for state in self.sessions.take_touched():
            try:
                self._send_queue += emission.emit(state, now, self._report, self.windows.outputs)
            except OutputsFailed as failure:
                self._fail(state, str(failure))
                continue
            self._send_queue += news_of(state)
            if state.complete:
                self._close(state, CloseReason.CLIENT, Code.OK, "")
            elif not self._stopping:
                sends_at = state.delivery.sends_at(state.planned_to)
                self.sessions.wake_up(state, min(self.windows.start_due(state, now), sends_at))
        self._flush()

    def _flush(self) -> None:
        outputs, self._send_queue = self._send_queue, []
        if outputs:
            self._deliver(outputs)

    # ---- windows and load --------------------------------------------------------------------------------------------

    def _take_in(self, finished: list[int]) -> None:
        """Decode the finished windows and hand them to their sessions."""
        results = self.windows.decode(finished, self._report)
        # Events that came during the step decide whether a window is too late: a client may have begun to play.
        self._take_events()
        for state, outputs in self.windows.land(results, self._clock.now(), self._report, self._load_monitor):
            if state.plan == 1:
                self.admission.note_begun(state.key)
            self._send_queue += outputs
            self.sessions.touch(state)

    def _fail(self, state: SessionState, message: str) -> None:
        self._close(state, CloseReason.ENGINE_FAULT, Code.INTERNAL, message)

    def _measure(self, now: float) -> None:
        """Measure the load; if the machine cannot keep up, or can again, give sessions less, or more."""
        self._send_queue += self._load_response.measure(now)
        message = "the server cannot keep up with all its sessions; open this one again later, or elsewhere"
        for state in self._load_response.to_shed():
            self._close(state, CloseReason.OVERLOAD, Code.RESOURCE_EXHAUSTED, message)
        self._load_response.describe(self._report)
        self._report.places, self._report.asked = self.admission.places(), self.admission.asked
