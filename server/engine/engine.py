"""Engine: the loop on its own thread: take events, schedule, step, deliver."""

from __future__ import annotations

import heapq
import itertools
import logging
import math
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from server.engine.config import EngineConfig
from server.engine.costs import CostTable, bucket
from server.engine.mailbox import Mailbox, refuse_pending
from server.engine.ports import Clock, Deliver, Inbox, Observe, Runner, SchedulingPolicy
from server.engine.report import StepReport
from server.engine.scheduler import ScheduledJob, Scheduler
from server.engine.session import SessionState
from server.engine.types import (
    Close,
    CloseReason,
    Code,
    Event,
    Open,
    Outcome,
    Output,
    Playhead,
    SessionKey,
    WindowJob,
    WindowResult,
)

_log = logging.getLogger(__name__)
_Item = TypeVar("_Item")
_Answer = TypeVar("_Answer")

# The longest sleep: it keeps the heartbeat fresh. The sweep looks for sessions that have gone silent.
_IDLE_TICK_S = 0.5
_SWEEP_EVERY_S = 1.0


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
    ) -> None:
        """inbox: where events come from, when not from `submit` alone. scheduler: a policy in place of `Scheduler`.

        Raises ValueError where the configuration does not fit the runner's model.
        """
        config.check_against(runner.facts)
        self._runner = runner
        self._facts = runner.facts
        self._clock = clock
        self._deliver = deliver
        self._observe = observe
        self._config = config
        self._mailbox: Inbox = inbox or Mailbox(config.max_pending_events)
        self._scheduler: SchedulingPolicy = scheduler or Scheduler(
            CostTable.assumed(config.initial_step_s), config.max_rows
        )
        self._sessions: dict[SessionKey, SessionState] = {}
        self._owners: dict[int, SessionState] = {}
        self._job_ids = itertools.count(1)
        self._ordinals = itertools.count()
        self._touched: dict[SessionKey, SessionState] = {}
        self._wakes: list[tuple[float, int, SessionState]] = []
        self._wake_order = itertools.count()
        self._next_sweep_at = clock.now() + _SWEEP_EVERY_S
        self._outbox: list[Output] = []
        self._report = StepReport()
        self._heartbeat_at = clock.now()
        self._draining = False
        self._stopping = False
        self._failure: BaseException | None = None
        self._thread: threading.Thread | None = None

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
        """Hand in an event. The answer comes through `deliver`; only a refusal at the door is returned."""
        if self._mailbox.put(event):
            return None
        return refuse_pending(event, self._config.max_pending_events)

    def drain(self) -> None:
        """Take no new sessions; those that are open are served on."""
        self._draining = True

    def stop(self) -> None:
        """Start no new windows, finish those that run, close every session as DRAINED, and end the loop."""
        self._draining = self._stopping = True
        self._mailbox.ring()

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
            while not self._stopping or len(self._scheduler):
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
            self._close_all(CloseReason.ENGINE_FAULT, Code.INTERNAL, "the server's engine failed; open a new session")

    def step(self) -> StepReport:
        """One round: events in, one denoising step for the most urgent rows, finished windows out."""
        self._report = StepReport()
        self._heartbeat_at = self._clock.now()
        self._take_events()
        self._wake_sessions()
        self._attend_touched()
        self._denoise(self._scheduler.schedule(self._clock.now()))
        self._attend_touched()
        if self._report.opens or self._report.closes:
            self._count_sessions()
        return self._report

    def idle_s(self) -> float:
        """How long the loop may sleep if nothing comes in."""
        wake_at = min(self._next_sweep_at, self._scheduler.wake_at(), self._wakes[0][0] if self._wakes else math.inf)
        return min(_IDLE_TICK_S, max(0.0, wake_at - self._clock.now()))

    # ---- events and sessions ----------------------------------------------------------------------------------------

    def _take_events(self) -> None:
        for event in self._mailbox.take_all():
            state = self._sessions.get(event.session)
            if isinstance(event, Open):
                self._open(event, state)
            elif state is None:
                self._refuse_unopened(event)
            elif isinstance(event, Close):
                self._close(state, event.reason, Code.OK, "")
            else:
                job = state.running.job if state.running else None
                self._outbox += state.apply(event, self._clock.now(), self._report)
                if job is not None and state.running is None:
                    self._discard(job.job_id)
                self._touch(state)

    def _open(self, event: Open, held: SessionState | None) -> None:
        refusal: tuple[Code, str, str, str] | None = None
        if held is not None:
            message = "a session with this handle is open on this stream; choose another handle"
            refusal = (Code.ALREADY_EXISTS, "HANDLE_IN_USE", message, "a handle that is not in use")
        elif self._draining:
            refusal = (Code.UNAVAILABLE, "DRAINING", "the server is going away; open the session elsewhere", "")
        elif len(self._sessions) >= self._config.max_sessions:
            limit = f"at most {self._config.max_sessions} sessions at once"
            refusal = (Code.RESOURCE_EXHAUSTED, "SESSION_LIMIT", "the server is full; try again later", limit)
        if refusal is not None:
            code, reason, message, allowed = refusal
            self._outbox.append(
                Outcome(event.session, event.event_seq, code, None, reason, message, "session", allowed)
            )
            self._report.opens.append(code)
            return
        state = SessionState.opened(
            event.spec, event.received_at, next(self._ordinals), self._facts, self._config, self._clock.now()
        )
        self._sessions[state.key] = state
        self._outbox.append(state.greeting())
        self._report.opens.append(Code.OK)
        self._touch(state)

    def _refuse_unopened(self, event: Event) -> None:
        if not isinstance(event, Playhead):
            message = "no session with this handle is open on this stream; open one first"
            self._outbox.append(
                Outcome(event.session, event.event_seq, Code.NOT_FOUND, None, "SESSION_NOT_OPEN", message, "session")
            )

    def _close(self, state: SessionState, reason: CloseReason, code: Code, message: str) -> None:
        if state.running is not None:
            self._discard(state.running.job.job_id)
        self._outbox += state.close(reason, code, message)
        self._report.closes.append(reason)
        del self._sessions[state.key]
        self._touched.pop(state.key, None)

    def _close_all(self, reason: CloseReason, code: Code, message: str) -> None:
        for state in list(self._sessions.values()):
            self._close(state, reason, code, message)
        self._flush()

    def _touch(self, state: SessionState) -> None:
        self._touched[state.key] = state

    def _wake_sessions(self) -> None:
        now = self._clock.now()
        while self._wakes and self._wakes[0][0] <= now:
            _, _, state = heapq.heappop(self._wakes)
            if self._sessions.get(state.key) is state:
                self._touch(state)
        if now >= self._next_sweep_at:
            self._next_sweep_at = now + _SWEEP_EVERY_S
            limit = self._config.idle_timeout_s
            for state in [held for held in self._sessions.values() if now - held.last_playhead_at > limit]:
                message = f"no Playhead for {limit:g} s; report the playhead at least that often"
                self._close(state, CloseReason.IDLE, Code.OK, message)
            self._count_sessions()

    def _attend_touched(self) -> None:
        """Send what the touched sessions may send, start the windows that are due, and deliver."""
        now = self._clock.now()
        touched, self._touched = self._touched, {}
        for state in touched.values():
            self._outbox += state.emit(now, self._report)
            if not self._stopping:
                self._start_window(state, now)
        self._flush()

    def _start_window(self, state: SessionState, now: float) -> None:
        if state.window_due(now):
            predicted_s = self._scheduler.predict_s(
                state.spec.priority, state.deadline(now), state.spec.denoise_steps, self._facts.guidance_passes
            )
            job = state.next_window(now, predicted_s, next(self._job_ids))
            self._owners[job.job_id] = state
            self._scheduler.add(job, self._runner.num_passes(job))
            return
        wake_at = state.wake_at()
        if wake_at < math.inf:
            heapq.heappush(self._wakes, (wake_at, next(self._wake_order), state))

    def _count_sessions(self) -> None:
        self._report.sessions = Counter((held.spec.priority, held.clock.state) for held in self._sessions.values())

    def _flush(self) -> None:
        outputs, self._outbox = self._outbox, []
        if outputs:
            self._deliver(outputs)

    # ---- windows ----------------------------------------------------------------------------------------------------

    def _denoise(self, batch: Sequence[ScheduledJob]) -> None:
        """Advance the batch by one step and take in the windows that this finishes."""
        if not batch:
            return
        begun_at = self._clock.now()
        num_new = sum(not held.prepared for held in batch)
        rows = self._prepare(batch, begun_at)
        prepared_at = self._clock.now()
        evaluations = sum(held.passes for held in batch)
        statuses = self._call(self._runner.denoise, rows, rows)
        for status in statuses:
            if status.finite:
                self._owners[status.job_id].advance(status.steps_done)
            else:
                self._fail_row(status.job_id)
        finished = self._scheduler.commit(status for status in statuses if status.finite)
        stepped_at = self._clock.now()
        self._decode(finished)
        ended_at = self._clock.now()
        costs = self._scheduler.costs
        if num_new:
            costs.prepare.observe(num_new, prepared_at - begun_at)
        if finished:
            costs.decode.observe(len(finished), ended_at - stepped_at)
        costs.step.observe(evaluations, stepped_at - prepared_at)
        self._report.rows = len(batch)
        self._report.bucket = bucket(evaluations)
        self._report.prepare_seconds = prepared_at - begun_at
        self._report.step_seconds = stepped_at - prepared_at
        self._report.decode_seconds = ended_at - stepped_at

    def _prepare(self, batch: Sequence[ScheduledJob], now: float) -> list[int]:
        """Give the runner the jobs it does not hold yet; returns the ids of the batch without those that failed."""
        new = [held.job for held in batch if not held.prepared]
        if new:
            self._report.queue_waits += [now - job.created_at for job in new]
            self._scheduler.mark_prepared(self._call(self._prepared_by_runner, new, [job.job_id for job in new]))
        return [held.job.job_id for held in batch if held.prepared]

    def _prepared_by_runner(self, jobs: Sequence[WindowJob]) -> list[int]:
        self._runner.prepare(jobs)
        return [job.job_id for job in jobs]

    def _decode(self, finished: Sequence[int]) -> None:
        results = self._call(self._runner.decode, finished, finished)
        if results:
            # What came during the step counts for whether a window is too late: a client may have begun to play.
            self._take_events()
        now = self._clock.now()
        for result in results:
            if result.job_id not in self._owners:
                continue
            if np.isfinite(result.frames).all() and np.isfinite(result.features).all():
                self._accept(result, now)
            else:
                self._fail_row(result.job_id)

    def _accept(self, result: WindowResult, now: float) -> None:
        state = self._owners.pop(result.job_id)
        self._scheduler.remove(result.job_id)
        self._outbox += state.accept(result, now, self._report)
        self._touch(state)

    def _call(
        self, call: Callable[[Sequence[_Item]], list[_Answer]], items: Sequence[_Item], job_ids: Sequence[int]
    ) -> list[_Answer]:
        """Call the runner for all items at once; if it raises, once more for each alone, and fail those that raise."""
        if not items:
            return []
        try:
            return call(items)
        except Exception:
            self._report.runner_faults += 1
            _log.exception("the runner failed for %d rows; trying each alone", len(items))
        answers: list[_Answer] = []
        for item, job_id in zip(items, job_ids, strict=True):
            try:
                answers += call([item])
            except Exception:
                self._report.runner_faults += 1
                _log.exception("the runner failed for session %s", self._owners[job_id].key)
                self._fail(job_id, "the model failed for this session's window; open a new session")
        return answers

    def _fail_row(self, job_id: int) -> None:
        self._report.nan_rows += 1
        self._fail(job_id, "the model made numbers that are not finite for this session; open a new session")

    def _fail(self, job_id: int, message: str) -> None:
        self._close(self._owners[job_id], CloseReason.ENGINE_FAULT, Code.INTERNAL, message)

    def _discard(self, job_id: int) -> None:
        """Forget a job that runs, here and in the runner; its result can reach nobody any more."""
        del self._owners[job_id]
        self._scheduler.remove(job_id)
        # Also where `prepare` has not succeeded: it may have got half way, and an unknown id is no error.
        self._runner.discard([job_id])
