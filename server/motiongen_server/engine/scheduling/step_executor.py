"""StepExecutor: makes a denoising step: prepares new jobs, steps, decodes finished ones; measures what this costs.

Failures of the runner are handled here: calls are repeated in parts, and jobs that fail are reported. Only DeviceLost
is raised.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from itertools import accumulate
from math import ceil, inf

import numpy as np

from motiongen_server.engine.ports import Clock, DeviceLost, OutOfMemory, Runner
from motiongen_server.engine.scheduling.batch_retry import BatchRetry, CallTime
from motiongen_server.engine.scheduling.costs import bucket
from motiongen_server.engine.scheduling.device import DeviceLease
from motiongen_server.engine.scheduling.device_use import DeviceUse
from motiongen_server.engine.scheduling.policy import SchedulingPolicy
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob
from motiongen_server.engine.types import Float32Array, RowStatus, WindowJob, WindowResult
from motiongen_server.engine.types.report import StepReport

_log = logging.getLogger(__name__)

# How fast the mean number of evaluations per row and step follows what is seen, for every row.
_PASSES_RATE = 1 / 4096
# How long a background that is held back waits before it asks again, in turn with the engines it is held back for.
_HELD_BACK_S = 0.005
_NOT_FINITE = "the model made numbers that are not finite for this session; open a new session"
_NO_ROOM = "the device has no memory left for this session's window; open a new session"
_FAILED = "the model failed for this session's window; open a new session"


class StepExecutor:
    """Takes jobs through the runner, in the policy's order.

    failed: called for every job that the model cannot do, with the reason in words for the client; it must call
    `discard`. begins: called for every job before it is prepared, with the seconds that it will take; it may return a
    job to replace it. lease: the engine's place at the device; all calls here are made during its turn.
    """

    def __init__(
        self,
        runner: Runner,
        policy: SchedulingPolicy,
        clock: Clock,
        max_rows: int,
        failed: Callable[[int, str], None],
        *,
        begins: Callable[[int, float], WindowJob | None],
        lease: DeviceLease,
    ) -> None:
        self._runner = runner
        self._policy = policy
        self._now = clock.now
        self._failed = failed
        self._begins = begins
        self._lease = lease
        spent = None if lease.quota is None else lease.quota.spent_s
        self._default_steps = runner.facts.default_steps
        self._report = StepReport()

        def read_clocks() -> CallTime:
            now = clock.now()
            return CallTime(now, now if spent is None else spent())

        self._prepares: BatchRetry[ScheduledJob, int] = BatchRetry(
            self._prepare, _id_of, self._give_up, self._prepared, read_clocks, max_rows
        )
        self._steps: BatchRetry[ScheduledJob, RowStatus] = BatchRetry(
            self._denoise, _id_of, self._give_up, self._stepped, read_clocks, max_rows
        )
        self._decodes: BatchRetry[int, WindowResult] = BatchRetry(
            runner.decode, int, self._give_up, self._decoded, read_clocks, max_rows
        )
        self._background: set[int] = set()
        self._passes = float(runner.facts.guidance_passes)
        if spent is not None:
            policy.costs.follow_processor()
        self._left_at: float | None = None  # when the last call ended, minus all waits for turns; None after idling
        self._own_s = 0.0  # the engine's own time between calls, since windows were last decoded
        self._decoded_at = -inf
        self.use = DeviceUse()
        self.held_until = inf
        """When to ask again for the next step, while the background is held back for other engines."""

    def __len__(self) -> int:
        """Jobs under way."""
        return len(self._policy)

    def add(self, job: WindowJob) -> None:
        """Add a window. Time spent on background windows does not count as load, since they take what is left."""
        if job.background:
            self._background.add(job.job_id)
        self._policy.add(job, self._runner.num_passes(job))
        self._tell_others()

    def finish(self, job_id: int) -> None:
        """Remove a job whose window was decoded."""
        self._background.discard(job_id)
        self._policy.remove(job_id)
        self._tell_others()

    def discard(self, job_id: int) -> None:
        """Forget a job at any stage, here and in the runner."""
        self._background.discard(job_id)
        self._policy.remove(job_id)
        self._tell_others()
        # Even if `prepare` failed: it may have got half way, and an unknown id is no error.
        self._runner.discard([job_id])

    def step(self, report: StepReport) -> tuple[list[RowStatus], list[int]]:
        """One denoising step for the most urgent jobs. Returns their statuses, and the jobs ready to be decoded."""
        batch = self._batch()
        if not batch:
            self._left_at = None
            return [], []
        self._report = report
        begun_at = self._now()
        self._count_own(begun_at)
        new = [held for held in batch if not held.prepared]
        if new:
            report.queue_waits += [begun_at - held.job.created_at for held in new]
            self._settle_starts(new)
            self._policy.mark_prepared(self._prepares(new))
            batch = [held for held in batch if held.prepared]
            report.prepare_seconds = self._now() - begun_at
        report.rows = len(batch)
        report.bucket = bucket(sum(held.passes for held in batch))
        statuses = self._steps(batch)
        for status in statuses:
            if not status.finite:
                self._not_finite(status.job_id)
        statuses = [status for status in statuses if status.finite]
        finished = self._policy.commit(statuses)
        ended_at = self._now()
        self._left_at = ended_at - self._lease.waited_s if batch else None
        report.step_seconds = ended_at - begun_at - report.prepare_seconds
        self._stream_metrics(report)
        return statuses, finished

    def _batch(self) -> Sequence[ScheduledJob]:
        """The jobs of the next step; if all are background jobs, only as many as other engines leave time for."""
        self.held_until = inf
        if not self._background or len(self._background) < len(self._policy):
            return self._policy.schedule(self._now())
        spare_s = self._lease.spare_s
        if spare_s <= 0.0:
            self.held_until = self._now() + _HELD_BACK_S
            return ()
        batch = self._policy.schedule(self._now())
        most = inf if spare_s == inf else self._policy.costs.step.largest_within(spare_s)
        evaluations = accumulate(held.passes for held in batch)
        return batch[: max(1, sum(each <= most for each in evaluations))]

    def _tell_others(self) -> None:
        """Publish what the device's other engines need to know of this one's windows."""
        self._lease.num_background = len(self._background)
        self._lease.num_waited_for = len(self._policy) - len(self._background)

    def _settle_starts(self, new: Sequence[ScheduledJob]) -> None:
        """Now that the batch is known, and so how long jobs will take, let some begin at another frame."""
        for held in new:
            job = self._begins(held.job.job_id, self._policy.left_s(held))
            if job is not None:
                self._policy.exchange(job, self._runner.num_passes(job))

    def decode(self, finished: Sequence[int], report: StepReport) -> list[WindowResult]:
        """The windows of jobs that have done all their steps, each to be finished or discarded."""
        self._report = report
        begun_at = self._now()
        self._count_own(begun_at)
        results = self._decodes(finished)
        sound = []
        for result in results:
            if np.isfinite(result.frames).all() and np.isfinite(result.features).all():
                sound.append(result)
            else:
                self._not_finite(result.job_id)
        ended_at = self._now()
        self._left_at = ended_at - self._lease.waited_s
        report.decode_seconds = ended_at - begun_at
        self._take_own(finished, ended_at)
        self._stream_metrics(report)
        return sound

    def _take_own(self, finished: Sequence[int], now: float) -> None:
        """Record the engine's own time since windows were last decoded, for the windows decoded now."""
        costs = self._policy.costs
        costs.observe_own(len(finished), self._own_s, now - self._decoded_at)
        self._decoded_at = now
        if self._lease.counts_own:
            counted = sum(job_id not in self._background for job_id in finished)
            busy_s = self._own_s * counted / len(finished)
            use = self.use
            self.use = DeviceUse(use.work_s + counted * costs.own_each_s, use.busy_s + busy_s, use.spent_s)
        self._own_s = 0.0

    def _count_own(self, begun_at: float) -> None:
        """Add the engine's own time since the last call, unless it was idle; without other engines' turns."""
        if self._left_at is not None:
            self._own_s += begun_at - self._lease.waited_s - self._left_at

    def features(self, rows: Float32Array) -> Float32Array | None:
        """The features (H, D) of a client's frames (H, row_width); None if the model fails on them."""
        try:
            features = self._runner.features(rows)
        except DeviceLost:
            raise
        except Exception:
            _log.exception("the runner failed for a session's prior frames")
            return None
        return features if np.isfinite(features).all() else None

    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array | None:
        """As `Runner.outputs`; None if the model fails."""
        try:
            made = self._runner.outputs(names, rows)
        except DeviceLost:
            raise
        except Exception:
            _log.exception("the runner failed for the outputs %s", ", ".join(names))
            return None
        return made if np.isfinite(made).all() else None

    def prices(self) -> Prices:
        """The present cost of a step and a window if steps are full, with the mean number of evaluations so far."""
        costs, turnover = self._policy.costs, self._turnover
        window_s = costs.prepare.spent_each_s(turnover) + costs.decode.spent_each_s(turnover)
        window_s += costs.own_each_s if self._lease.counts_own else 0.0
        return Prices(self._passes * costs.step.spent_each_s(self._policy.largest_step), window_s)

    @property
    def _turnover(self) -> int:
        """Windows that begin and end together when steps are full: half of those in a step, as observed with crowds."""
        return max(1, ceil(self._policy.largest_step / (2 * self._passes)))

    # ---- calls of the runner ----------------------------------------------------------------------------------------

    def _prepare(self, jobs: Sequence[ScheduledJob]) -> list[int]:
        self._runner.prepare([held.job for held in jobs])
        return [held.job.job_id for held in jobs]

    def _denoise(self, jobs: Sequence[ScheduledJob]) -> list[RowStatus]:
        return self._runner.denoise([held.job.job_id for held in jobs])

    def _prepared(self, jobs: Sequence[ScheduledJob], took: CallTime) -> None:
        costs = self._policy.costs.prepare
        costs.observe(len(jobs), *took)
        counted = sum(not held.job.background for held in jobs)
        self._count(took, counted / len(jobs), counted * costs.spent_each_s(self._turnover))

    def _stepped(self, jobs: Sequence[ScheduledJob], took: CallTime) -> None:
        costs = self._policy.costs.step
        evaluations = sum(held.passes for held in jobs)
        costs.observe(evaluations, *took)
        self._passes += min(1.0, _PASSES_RATE * len(jobs)) * (evaluations / len(jobs) - self._passes)
        counted = sum(held.passes for held in jobs if not held.job.background)
        self._count(took, counted / evaluations, counted * costs.spent_each_s(self._policy.largest_step))

    def _decoded(self, job_ids: Sequence[int], took: CallTime) -> None:
        costs = self._policy.costs.decode
        costs.observe(len(job_ids), *took)
        counted = sum(job_id not in self._background for job_id in job_ids)
        self._count(took, counted / len(job_ids), counted * costs.spent_each_s(self._turnover))

    def _count(self, took: CallTime, share: float, work_s: float) -> None:
        """share: of the call, without the background's part."""
        self._lease.note_call(took.seconds, 1.0 - share)
        use = self.use
        self.use = DeviceUse(use.work_s + work_s, use.busy_s + share * took.seconds, use.spent_s + share * took.spent_s)

    # ---- failures ---------------------------------------------------------------------------------------------------

    def _give_up(self, job_id: int, error: Exception) -> None:
        self._failed(job_id, _NO_ROOM if isinstance(error, OutOfMemory) else _FAILED)

    def _not_finite(self, job_id: int) -> None:
        self._report.nan_rows += 1
        self._failed(job_id, _NOT_FINITE)

    def _stream_metrics(self, report: StepReport) -> None:
        for calls in (self._prepares, self._steps, self._decodes):
            report.runner_faults += calls.faults
            report.memory_splits += calls.splits
            calls.faults = calls.splits = 0


def _id_of(held: ScheduledJob) -> int:
    return held.job.job_id
