"""RunningWindows: the windows that the runner works on, each with the session that asked for it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from math import inf

from motiongen_server.engine.ports import Clock, Runner
from motiongen_server.engine.scheduling.device import DeviceLease
from motiongen_server.engine.scheduling.device_use import DeviceUse
from motiongen_server.engine.scheduling.load_monitor import LoadMonitor
from motiongen_server.engine.scheduling.policy import SchedulingPolicy
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.scheduling.step_executor import StepExecutor
from motiongen_server.engine.scheduling.step_quotas import StepQuotas
from motiongen_server.engine.session import planning
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import Float32Array, Output, PlanCause, WindowJob, WindowResult
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine.window_timings import WindowTimings


class RunningWindows:
    """Takes sessions' next windows through the runner until they become plans.

    failed: called with a session whose window cannot be made, and why; it must close the session, which discards the
    window. trace_as: this engine's name in the timings of windows; empty: no timings are given.
    """

    def __init__(
        self,
        runner: Runner,
        clock: Clock,
        scheduler: SchedulingPolicy,
        lease: DeviceLease,
        *,
        max_rows: int,
        failed: Callable[[SessionState, str], None],
        trace_as: str = "",
    ) -> None:
        self._scheduler = scheduler
        self._lease = lease
        self.timings = WindowTimings(trace_as) if trace_as else None
        self._passes = runner.facts.guidance_passes
        self.quotas = StepQuotas()
        self._now = clock.now
        self._owners: dict[int, SessionState] = {}
        self._charged: dict[int, tuple[WindowJob, float]] = {}  # what windows before their first step were charged
        self._replans: dict[int, tuple[WindowJob, float]] = {}  # replans under way, each with its share of the steps
        self._begun_replans: list[tuple[WindowJob, float]] = []
        self._job_ids = itertools.count(1)
        self._executor = StepExecutor(
            runner,
            scheduler,
            clock,
            max_rows,
            failed=lambda job_id, why: failed(self._owners[job_id], why),
            begins=self._begin_elsewhere,
            lease=lease,
        )

    def __len__(self) -> int:
        return len(self._executor)

    @property
    def owners(self) -> Mapping[int, SessionState]:
        """The session of each window, by job number."""
        return self._owners

    @property
    def use(self) -> DeviceUse:
        """The use of the device since the start."""
        return self._executor.use

    def prices(self) -> Prices:
        """What a step and a window cost at present."""
        return self._executor.prices()

    def wake_at(self) -> float:
        """When to step again although no event came: set by the scheduler, or by background work that is held back."""
        return min(self._scheduler.wake_at(), self._executor.held_until)

    def features(self, rows: Float32Array) -> Float32Array | None:
        """The features (H, D) of a client's frames (H, row_width); None if the model fails on them."""
        return self._executor.features(rows)

    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array | None:
        """As `Runner.outputs`; None if the model fails."""
        return self._executor.outputs(names, rows)

    def start_due(self, state: SessionState, now: float) -> float:
        """Start a session's next window if it is due. Returns when to look again; infinity: not for time alone."""
        ready_at = self.quotas.ready_at(state.spec.owner, now)
        if ready_at > now:
            state.edits.wait_until(ready_at)
        look_at = ready_at if ready_at > now else inf
        if not planning.window_due(state, now):
            return min(look_at, planning.wake_at(state))
        self._start(state, now)
        return look_at

    def _start(self, state: SessionState, now: float) -> None:
        predicted_s = self._scheduler.predict_s(
            state.spec.priority, planning.deadline(state, now), planning.num_steps_due(state, now), self._passes
        )
        job = planning.next_window(state, now, predicted_s * self._lease.stretch, next(self._job_ids))
        self._charged[job.job_id] = job, self.quotas.charge(job.owner, job.num_steps, now)
        self._owners[job.job_id] = state
        self._executor.add(job)
        if job.cause is not PlanCause.CONTINUE and not job.background:
            self._replans[job.job_id] = replan = job, job.num_steps / state.spec.denoise_steps
            self._begun_replans.append(replan)

    def _begin_elsewhere(self, job_id: int, left_s: float) -> WindowJob | None:
        """The runner is about to take a window, so its charge is spent. See `planning.begin_elsewhere`."""
        job, _ = self._charged.pop(job_id)
        self.quotas.note_begun(job.owner, job.num_steps)
        return planning.begin_elsewhere(self._owners[job_id], self._now(), left_s * self._lease.stretch)

    def take_replans(self) -> list[tuple[WindowJob, float]]:
        """The windows begun since the last call that change what would be shown, each with its share of all steps.

        The share is of the steps that the session asked for. A discarded window is listed again, with a negative share.
        """
        taken, self._begun_replans = self._begun_replans, []
        return taken

    def step(self, report: StepReport) -> list[int]:
        """One denoising step for the most urgent windows. Returns the jobs that are ready to be decoded."""
        statuses, finished = self._executor.step(report)
        if self.timings is not None:
            self.timings.note_step(statuses, self._now() - report.step_seconds)
        for status in statuses:
            self._owners[status.job_id].advance(status.steps_done)
        return finished

    def decode(self, finished: Sequence[int], report: StepReport) -> list[WindowResult]:
        """The frames of finished windows."""
        return self._executor.decode(finished, report)

    def land(
        self, results: Sequence[WindowResult], now: float, report: StepReport, load: LoadMonitor
    ) -> list[tuple[SessionState, list[Output]]]:
        """Hand windows to their sessions. Returns each session with its outputs."""
        said = []
        due, late = 0, 0.0
        for result in results:
            state = self._owners.pop(result.job_id, None)
            if state is None:
                continue  # discarded meanwhile, as its session was closed or its window restarted
            self._executor.finish(result.job_id)
            self._replans.pop(result.job_id, None)
            running = state.running
            misses, held = len(report.deadline_misses), state.holding
            outputs = planning.accept(state, result, now, report)
            if self.timings is not None and running is not None:
                outputs = self.timings.with_timing(outputs, running, now)
            said.append((state, outputs))
            # Only windows that continue show whether the machine keeps up: edits may ask for more than it could ever
            # do, and a session that was held is late because of that.
            if running is not None and not held and _shows_load(running.job):
                due += 1
                if len(report.deadline_misses) > misses:
                    late += running.late_share(now)
        load.note_windows(now, due, late)
        return said

    def discard(self, job_id: int) -> None:
        """Forget a running job, whose result nobody needs any more."""
        if self.timings is not None:
            self.timings.forget(job_id)
        del self._owners[job_id]
        if job_id in self._replans:
            job, share = self._replans.pop(job_id)
            self._begun_replans.append((job, -share))
        if job_id in self._charged:
            job, charged = self._charged.pop(job_id)
            self.quotas.give_back(job.owner, charged)
        self._executor.discard(job_id)


def _shows_load(job: WindowJob) -> bool:
    return job.cause is PlanCause.CONTINUE and job.first_frame > 0 and not job.background
