"""RunningWindows: the windows that the runner works on, each for the session that asked for it."""

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
    """From a session's next window to the plan that it becomes.

    failed: told of a session whose window cannot be made, and why; it is to close it, and so to discard the window.
    trace_as: the name that timings of windows give this engine; none are given where it is empty.
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
        self._charged: dict[int, tuple[WindowJob, float]] = {}  # of those that wait for their first step
        self._replans: dict[int, tuple[WindowJob, float]] = {}  # of those under way
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
        """The session of each window, by its job's number."""
        return self._owners

    @property
    def use(self) -> DeviceUse:
        """Of the device, so far."""
        return self._executor.use

    def prices(self) -> Prices:
        """What a step and a window cost by now."""
        return self._executor.prices()

    def wake_at(self) -> float:
        """When to step again though nothing has come in: as the scheduler says, or for a background held back."""
        return min(self._scheduler.wake_at(), self._executor.held_until)

    def features(self, rows: Float32Array) -> Float32Array | None:
        """The features (H, D) of a client's frames (H, row_width); None where the model can make none of them."""
        return self._executor.features(rows)

    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array | None:
        """As `Runner.outputs`; None where the model can make none of these."""
        return self._executor.outputs(names, rows)

    def start_due(self, state: SessionState, now: float) -> float:
        """Start the window that a session is due, if one is; when to look again, infinity: not for time alone."""
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
        """The runner takes a window: what it was charged is spent. See `planning.begin_elsewhere`."""
        job, _ = self._charged.pop(job_id)
        self.quotas.note_begun(job.owner, job.num_steps)
        return planning.begin_elsewhere(self._owners[job_id], self._now(), left_s * self._lease.stretch)

    def take_replans(self) -> list[tuple[WindowJob, float]]:
        """The windows begun since this was last asked that change what would be shown, each with its share of a whole
        one's steps; those that were let go of count against others."""
        taken, self._begun_replans = self._begun_replans, []
        return taken

    def step(self, report: StepReport) -> list[int]:
        """One denoising step for the most urgent windows; the jobs that are ready to be decoded."""
        statuses, finished = self._executor.step(report)
        if self.timings is not None:
            self.timings.note_step(statuses, self._now() - report.step_seconds)
        for status in statuses:
            self._owners[status.job_id].advance(status.steps_done)
        return finished

    def decode(self, finished: Sequence[int], report: StepReport) -> list[WindowResult]:
        """The frames of windows that are done."""
        return self._executor.decode(finished, report)

    def land(
        self, results: Sequence[WindowResult], now: float, report: StepReport, load: LoadMonitor
    ) -> list[tuple[SessionState, list[Output]]]:
        """Give windows to their sessions; each of them, with what is said of it."""
        said = []
        due, late = 0, 0.0
        for result in results:
            state = self._owners.pop(result.job_id, None)
            if state is None:
                continue  # closed or restarted meanwhile, and discarded
            self._executor.finish(result.job_id)
            self._replans.pop(result.job_id, None)
            running = state.running
            misses, held = len(report.deadline_misses), state.holding
            outputs = planning.accept(state, result, now, report)
            if self.timings is not None and running is not None:
                outputs = self.timings.with_timing(outputs, running, now)
            said.append((state, outputs))
            # Only who goes on shows whether the machine keeps up: edits may ask for more than it could ever do, and who
            # was made to stand is late by that.
            if running is not None and not held and _shows_load(running.job):
                due += 1
                if len(report.deadline_misses) > misses:
                    late += running.late_share(now)
        load.note_windows(now, due, late)
        return said

    def discard(self, job_id: int) -> None:
        """Forget a job that runs; its result can reach nobody any more."""
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
