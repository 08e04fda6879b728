"""Engine: the loop on its own thread: take events, schedule, step, deliver."""

from __future__ import annotations

import itertools
import logging
import math
import threading
from collections import Counter
from collections.abc import Iterable

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.mailbox import Mailbox, pending_refusal
from motiongen_server.engine.ports import Clock, Deliver, Inbox, Observe, Runner
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.degradation import EXPENDABLE
from motiongen_server.engine.scheduling.device import Device, DeviceLease
from motiongen_server.engine.scheduling.load_monitor import LoadMonitor
from motiongen_server.engine.scheduling.policy import SchedulingPolicy
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.scheduling.step_executor import StepExecutor
from motiongen_server.engine.scheduling.step_quotas import StepQuotas
from motiongen_server.engine.session import emission, events, planning
from motiongen_server.engine.session.opening import open_session
from motiongen_server.engine.session.snapshot import check_going_on, going_on, news_of
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.timers import Timers
from motiongen_server.engine.types import (
    Close,
    CloseReason,
    Code,
    Event,
    EventRefused,
    Open,
    Outcome,
    Output,
    PlanCause,
    Playhead,
    PlayState,
    Priority,
    Resume,
    SessionKey,
    SetPlayState,
)
from motiongen_server.engine.types.refusals import handle_in_use, session_not_open
from motiongen_server.engine.types.report import StepReport

_log = logging.getLogger(__name__)

# The longest sleep: it keeps the heartbeat fresh.
_IDLE_TICK_S = 0.5
# Of the sessions that may be shed, so many are, each time that the last level did not help.
_SHED_SHARE = 0.05


class Engine:
    """Generates the motion of all sessions with one runner.

    `submit`, `drain`, `stop` and the properties may be used from any thread; `step` belongs to the engine's thread, or
    to a test that runs the loop by hand. `deliver` and `observe` are called on the engine's thread.
    """

    def __init__(
        self,
        runner: Runner,
        clock: Clock,
        deliver: Deliver,
        config: EngineConfig,
        observe: Observe | None = None,
        inbox: Inbox | None = None,
        scheduler: SchedulingPolicy | None = None,
        lease: DeviceLease | None = None,
    ) -> None:
        """inbox: where events come from, when not from `submit` alone. scheduler: a policy in place of `Scheduler`.

        lease: this engine's at a device that other engines use too; it is left at the end.
        Raises ValueError where the configuration does not fit the runner's model.
        """
        config.check_against(runner.facts)
        now = clock.now()
        self._facts = runner.facts
        self._clock = clock
        self._deliver = deliver
        self._observe = observe
        self._config = config
        self._mailbox: Inbox = Mailbox(config.max_pending_events) if inbox is None else inbox
        if scheduler is None:  # not `or`: a policy that holds no jobs yet is false
            scheduler = Scheduler(
                CostTable.assumed(config.initial_step_s), config.max_rows, max_step_s=config.max_step_s
            )
        self._scheduler: SchedulingPolicy = scheduler
        self._executor = StepExecutor(runner, self._scheduler, clock, config.max_rows, self._fail)
        self._admission = Admission(runner.facts, config)
        self._quotas = StepQuotas()
        self._lease = Device().lease() if lease is None else lease
        self._load_monitor = LoadMonitor(runner.facts, self._admission, now, config.degrade, self._lease)
        self._sessions: dict[SessionKey, SessionState] = {}
        self._present: Counter[Priority] = Counter()
        self._counts: Counter[tuple[Priority, PlayState]] = Counter()
        self._recounted = True
        self._owners: dict[int, SessionState] = {}
        self._job_ids = itertools.count(1)
        self._ordinals = itertools.count()
        self._touched: dict[SessionKey, SessionState] = {}
        self._timers = Timers()
        self._silences = Timers()
        self._send_queue: list[Output] = []
        self._report = StepReport()
        self._heartbeat_at = now
        self._stopping = False
        self._failure: BaseException | None = None
        self._thread: threading.Thread | None = None
        self._measure(now)

    # ---- from any thread --------------------------------------------------------------------------------------------

    @property
    def num_sessions(self) -> int:
        return len(self._sessions)

    @property
    def heartbeat_at(self) -> float:
        """When the loop last went round, on the engine's clock. At most half a second old while the engine is well."""
        return self._heartbeat_at

    @property
    def failure(self) -> BaseException | None:
        """What ended the loop, if it did not end as it should."""
        return self._failure

    def start(self) -> None:
        """Run the loop on a thread of its own."""
        self._thread = threading.Thread(target=self.run, name="engine", daemon=True)
        self._thread.start()

    def submit(self, event: Event) -> Outcome | None:
        """Hand in an event. The answer comes through `deliver`; only one that is refused here is returned, at once."""
        if isinstance(event, Open):
            refusal = self._admission.reserve(event.spec, event.event_seq)
            if refusal is not None:
                return refusal
        elif isinstance(event, Close):
            self._admission.release(event.session)  # its place can be taken at once
        if self._mailbox.put(event):
            return None
        if isinstance(event, Open):
            self._admission.release(event.session, event.spec)
        return pending_refusal(event, self._config.max_pending_events)

    def refusal_of(self, event: Open) -> Outcome | None:
        """What an Open would be refused with as things stand; no place is held."""
        return self._admission.refusal_of(event.spec, event.event_seq)

    def drain(self) -> None:
        """Take no new sessions; those that are open are served on."""
        self._admission.close()

    def stop(self) -> None:
        """Start no new windows, finish those that run, close every session as DRAINED, and end the loop."""
        self._admission.close()
        self._stopping = True
        self._mailbox.ring()
        if self._thread is None:  # it never began, and will not leave by itself
            self._lease.leave()

    def join(self, timeout_s: float | None = None) -> bool:
        """Wait for the loop to end. True if it has."""
        if self._thread is None:
            return True
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    # ---- the loop ---------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Go round until stopped. An error of the engine itself closes every session; `failure` then holds it."""
        try:
            while not self._stopping or len(self._executor):
                with self._lease:
                    report = self.step()
                if self._observe is not None:
                    self._observe(report)
                if not report.rows and not self._stopping:
                    self._mailbox.wait(self.idle_s())
            self._take_events()
            self._close_all(CloseReason.DRAINED, Code.UNAVAILABLE, "the server is going away; open a session elsewhere")
        except Exception as error:
            _log.exception("the engine's loop failed")
            self._failure = error
            self._admission.close()
            self._close_all(CloseReason.ENGINE_FAULT, Code.INTERNAL, "the server's engine failed; open a new session")
        finally:
            self._lease.leave()

    def step(self) -> StepReport:
        """One round: events in, one denoising step for the most urgent rows, finished windows out."""
        self._report = report = StepReport()
        self._heartbeat_at = now = self._clock.now()
        self._take_events()
        self._wake_sessions(now)
        self._attend_touched()
        statuses, finished = self._executor.step(report)
        for status in statuses:
            self._owners[status.job_id].advance(status.steps_done)
        if finished:
            self._take_in(finished)
        self._attend_touched()
        now = self._clock.now()
        if now >= self._load_monitor.due_at:
            self._measure(now)
            self._flush()
        report.opens += self._admission.take_refused().elements()
        if self._recounted:
            self._recounted = False
            report.sessions = +self._counts
        return report

    def idle_s(self) -> float:
        """How long the loop may sleep if nothing comes in."""
        wake_at = min(self._timers.next_at(), self._silences.next_at(), self._scheduler.wake_at())
        return min(_IDLE_TICK_S, max(0.0, wake_at - self._clock.now()))

    # ---- events and sessions ----------------------------------------------------------------------------------------

    def _take_events(self) -> None:
        now = self._clock.now()
        for event in self._mailbox.take_all():
            state = self._sessions.get(event.session)
            if isinstance(event, Open):
                self._open(event, state)
            elif state is None:
                if not isinstance(event, Playhead | Resume):
                    self._refuse(event, session_not_open(event.session.handle))
            elif isinstance(event, Close):
                self._close(state, event.reason, Code.OK, "")
            else:
                job = state.running.job if state.running else None
                if isinstance(event, SetPlayState):
                    self._recount(state, -1)
                    self._send_queue += events.apply(state, event, now, self._report)
                    self._recount(state, 1)
                else:
                    self._send_queue += events.apply(state, event, now, self._report)
                if job is not None and state.running is None:
                    self._discard(job.job_id)
                self._touched[state.key] = state

    def _open(self, event: Open, held: SessionState | None) -> None:
        if held is not None:
            self._report.opens.append(self._refuse(event, handle_in_use(event.session.handle)))
            return
        refusal = self._admission.reserve(event.spec, event.event_seq)
        if refusal is not None:
            self._send_queue.append(refusal)
            return
        spec, now = event.spec, self._clock.now()
        try:
            state = self._begun(event, now)
        except EventRefused as failed:
            self._admission.release(spec.session, spec)
            self._report.opens.append(self._refuse(event, failed))
            return
        self._sessions[state.key] = self._touched[state.key] = state
        self._send_queue.append(state.greeting())
        if (asked := event.going_on) is not None:
            resume = Resume(state.key, 0, event.received_at, asked.attempt, asked.next_frame, asked.plan)
            self._send_queue += events.apply(state, resume, now, self._report)
        self._report.opens.append(Code.OK)
        if spec.is_clip:  # it gets all it asked for, late if need be, and says nothing until it ends
            return
        self._present[spec.priority] += 1
        self._recount(state, 1)
        self._silences.ask(state.key, now + self._config.idle_timeout_s)
        self._send_queue += state.set_tier(self._load_monitor.level(spec.priority))

    def _begun(self, event: Open, now: float) -> SessionState:
        """The session that an Open begins, or goes on with. Raises EventRefused."""
        asked, config = event.going_on, self._config
        rows = event.spec.prior_rows if asked is None else asked.snapshot.rows
        if asked is not None:
            check_going_on(asked, self._facts)
        features = None if rows is None else self._executor.features(rows)
        if rows is not None and features is None:
            given, allowed = "the model can make nothing of the prior frames", "other frames, or none"
            raise EventRefused(Code.INTERNAL, "PRIOR_FRAMES_FAILED", given, "open.prior_frames", allowed)
        ordinal = next(self._ordinals)
        if asked is not None and features is not None:
            return going_on(event, asked, ordinal, self._facts, config, now, features)
        return open_session(event.spec, event.received_at, ordinal, self._facts, config, now, features)

    def _refuse(self, event: Event, refusal: EventRefused) -> Code:
        """Answer an event that does not reach a session."""
        self._send_queue.append(refusal.outcome(event.session, event.event_seq))
        return refusal.code

    def _close(self, state: SessionState, reason: CloseReason, code: Code, message: str) -> None:
        if state.running is not None:
            self._discard(state.running.job.job_id)
        self._send_queue += state.close(reason, code, message)
        self._report.closes.append(reason)
        if not state.spec.is_clip:
            self._present[state.spec.priority] -= 1
            self._recount(state, -1)
        del self._sessions[state.key]
        self._touched.pop(state.key, None)
        self._timers.forget(state.key)
        self._silences.forget(state.key)
        self._admission.release(state.key, state.spec)

    def _close_all(self, reason: CloseReason, code: Code, message: str) -> None:
        for state in list(self._sessions.values()):
            self._close(state, reason, code, message)
        self._flush()

    def _recount(self, state: SessionState, change: int) -> None:
        self._counts[(state.spec.priority, state.clock.state)] += change
        self._recounted = True

    def _wake_sessions(self, now: float) -> None:
        for key in self._timers.due(now):
            self._touched[key] = self._sessions[key]
        for key in self._silences.due(now):
            state, limit = self._sessions[key], self._config.idle_timeout_s
            if now >= state.idle_at:
                message = f"no Playhead for {limit:g} s, or none that moved; report the frame shown at least that often"
                self._close(state, CloseReason.IDLE, Code.OK, message)
            else:
                self._silences.ask(key, state.idle_at)

    def _attend_touched(self) -> None:
        """Send what the touched sessions may send, start the windows that are due, and deliver."""
        now = self._clock.now()
        touched, self._touched = self._touched, {}
        for state in touched.values():
            self._send_queue += emission.emit(state, now, self._report)
            if self._config.snapshots and (news := news_of(state)) is not None:
                self._send_queue.append(news)
            if state.complete:
                self._close(state, CloseReason.CLIENT, Code.OK, "")
            elif not self._stopping:
                self._start_window(state, now)
        self._flush()

    def _start_window(self, state: SessionState, now: float) -> None:
        ready_at = self._quotas.ready_at(state.spec.owner, now)
        if ready_at > now:
            state.edits.wait_until(ready_at)
            self._timers.ask(state.key, ready_at)
        if planning.window_due(state, now):
            predicted_s = self._scheduler.predict_s(
                state.spec.priority, planning.deadline(state, now), state.num_steps, self._facts.guidance_passes
            )
            job = planning.next_window(state, now, predicted_s * self._lease.stretch, next(self._job_ids))
            self._quotas.charge(job.owner, job.num_steps, now)
            self._owners[job.job_id] = state
            self._executor.add(job)
        else:
            self._timers.ask(state.key, planning.wake_at(state))

    def _flush(self) -> None:
        outputs, self._send_queue = self._send_queue, []
        if outputs:
            self._deliver(outputs)

    # ---- windows ----------------------------------------------------------------------------------------------------

    def _take_in(self, finished: Iterable[int]) -> None:
        """Decode the windows that are done and give them to their sessions."""
        results = self._executor.decode(list(finished), self._report)
        # What came during the step counts for whether a window is too late: a client may have begun to play.
        self._take_events()
        now = self._clock.now()
        due = late = 0
        for result in results:
            state = self._owners.pop(result.job_id, None)
            if state is None:
                continue  # closed or restarted meanwhile, and discarded
            self._executor.finish(result.job_id)
            job = state.running.job if state.running else None
            misses = len(self._report.deadline_misses)
            self._send_queue += planning.accept(state, result, now, self._report)
            self._touched[state.key] = state
            if job is not None and not job.background:
                self._load_monitor.note_window(job.priority)
            # Only who goes on shows whether the machine keeps up: edits may ask for more than it could ever do.
            if job is not None and job.cause is PlanCause.CONTINUE and job.first_frame and not job.background:
                due += 1
                late += len(self._report.deadline_misses) - misses
        self._load_monitor.note_windows(now, due, late)

    def _fail(self, job_id: int, message: str) -> None:
        self._close(self._owners[job_id], CloseReason.ENGINE_FAULT, Code.INTERNAL, message)

    def _discard(self, job_id: int) -> None:
        """Forget a job that runs; its result can reach nobody any more."""
        del self._owners[job_id]
        self._executor.discard(job_id)

    # ---- load -------------------------------------------------------------------------------------------------------

    def _measure(self, now: float) -> None:
        """Take stock of the load; where the machine cannot keep up, or can again, sessions get less, or more."""
        moved = self._load_monitor.measure(
            now, self._executor.work_s, self._executor.busy_s, self._executor.prices(), self._present
        )
        for priority in moved:
            level = self._load_monitor.level(priority)
            _log.warning(
                "the load is %.0f %%: class %s is served %s now, with at most %s steps",
                100 * self._load_monitor.load,
                priority.name,
                level.tier.name,
                level.steps or "all",
            )
            for state in self._sessions.values():
                if state.spec.priority is priority and not state.spec.is_clip:
                    self._send_queue += state.set_tier(level)
                    self._touched[state.key] = state
        if self._load_monitor.shed:
            self._shed()
        self._report.load = self._load_monitor.load
        self._report.full = self._admission.full
        self._report.tiers = {priority: self._load_monitor.level(priority).tier for priority in Priority}

    def _shed(self) -> None:
        """Close some of the least urgent sessions, the newest first."""
        lowest = max(priority for priority in EXPENDABLE if self._present[priority])
        of_class = [
            state
            for state in reversed(self._sessions.values())
            if state.spec.priority is lowest and not state.spec.is_clip
        ]
        message = "the server cannot keep up with all its sessions; open this one again later, or elsewhere"
        for state in of_class[: math.ceil(_SHED_SHARE * len(of_class))]:
            self._close(state, CloseReason.OVERLOAD, Code.RESOURCE_EXHAUSTED, message)
