"""Baseline scheduling policies: one window at a time, batches of whole windows, steps first-in first-out.

Each satisfies `motiongen_server.engine.ports.SchedulingPolicy`, so that it runs in the same engine as `Scheduler`.
None considers deadlines, classes or costs; costs are recorded only to predict when a window will be finished, which the
engine needs.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from math import ceil, inf

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob
from motiongen_server.engine.types import Priority, RowStatus, WindowJob

_MOST_PASSES = 3  # evaluations per step of a window


class Queue:
    """Jobs in the order of arrival. The base of the policies, which add `schedule` and `rounds_ahead`."""

    def __init__(self, costs: CostTable) -> None:
        self.costs = costs
        self._jobs: dict[int, ScheduledJob] = {}

    def __len__(self) -> int:
        return len(self._jobs)

    def add(self, job: WindowJob, passes: int) -> None:
        self._jobs[job.job_id] = ScheduledJob(job, passes)

    def remove(self, job_id: int) -> None:
        del self._jobs[job_id]

    def exchange(self, job: WindowJob, passes: int) -> None:
        held = self._jobs[job.job_id]
        held.job, held.passes = job, passes

    @property
    def largest_step(self) -> int:
        """The most evaluations of a step: those of one window, unless a policy runs more at once."""
        return _MOST_PASSES

    def wake_at(self) -> float:
        return inf

    def mark_prepared(self, job_ids: Iterable[int]) -> None:
        for job_id in job_ids:
            self._jobs[job_id].prepared = True

    def commit(self, statuses: Iterable[RowStatus]) -> list[int]:
        return [status.job_id for status in statuses if self._jobs[status.job_id].note(status)]

    def left_s(self, held: ScheduledJob) -> float:
        jobs = min(len(self._jobs), max(1, self.largest_step // _MOST_PASSES))
        return self._window_s(held.job.num_steps - held.steps_done, jobs, held.job.num_steps, held.passes)

    def _window_s(self, rounds: int, rows: int, num_steps: int, passes: int) -> float:
        """The duration of so many rounds of `rows` windows with these steps and passes."""
        return self.costs.window_s(num_steps, rounds, max(1, rows) * passes, max(1, rows))


class OneAtATime(Queue):
    """All steps of the oldest job alone, then the next job."""

    def schedule(self, now: float) -> list[ScheduledJob]:
        del now
        return [next(iter(self._jobs.values()))] if self._jobs else []

    def predict_s(self, priority: Priority, deadline: float, num_steps: int, passes: int) -> float:
        del priority, deadline
        return self._window_s((len(self._jobs) + 1) * num_steps, 1, num_steps, passes)


class StepsInOrder(Queue):
    """Step batching, first in first out: the oldest jobs of any shape; a finished row makes room at once."""

    def __init__(self, costs: CostTable, max_rows: int) -> None:
        super().__init__(costs)
        self._max_rows = max_rows

    @property
    def largest_step(self) -> int:
        return self._max_rows * _MOST_PASSES

    def schedule(self, now: float) -> list[ScheduledJob]:
        del now
        return [held for held, _ in zip(self._jobs.values(), range(self._max_rows), strict=False)]

    def predict_s(self, priority: Priority, deadline: float, num_steps: int, passes: int) -> float:
        del priority, deadline
        jobs = len(self._jobs) + 1
        rounds = ceil(num_steps * max(1.0, jobs / self._max_rows))
        return self._window_s(rounds, min(jobs, self._max_rows), num_steps, passes)


class WholeWindows(Queue):
    """Batches of whole windows of one shape: collected for a short time, then run to their end; none joins meanwhile.

    shape_of: what the jobs of a batch share. wait_s: how long the oldest job waits, at most, for others of its shape.
    """

    def __init__(
        self, costs: CostTable, max_rows: int, shape_of: Callable[[WindowJob], Hashable], wait_s: float = 0.02
    ) -> None:
        super().__init__(costs)
        self._max_rows = max_rows
        self._shape_of = shape_of
        self._wait_s = wait_s
        self._shapes: dict[int, Hashable] = {}
        self._batch: list[int] = []

    @property
    def largest_step(self) -> int:
        return self._max_rows * _MOST_PASSES

    def add(self, job: WindowJob, passes: int) -> None:
        super().add(job, passes)
        self._shapes[job.job_id] = self._shape_of(job)

    def remove(self, job_id: int) -> None:
        super().remove(job_id)
        del self._shapes[job_id]
        if job_id in self._batch:
            self._batch.remove(job_id)

    def schedule(self, now: float) -> list[ScheduledJob]:
        if not self._batch and self._jobs:
            batch = self._next_batch()
            if len(batch) == self._max_rows or self.wake_at() <= now:
                self._batch = batch
        return [self._jobs[job_id] for job_id in self._batch]

    def _next_batch(self) -> list[int]:
        """The oldest job and as many others of its shape as fit."""
        shape = self._shapes[next(iter(self._jobs))]
        return [job_id for job_id in self._jobs if self._shapes[job_id] == shape][: self._max_rows]

    def wake_at(self) -> float:
        if self._batch or not self._jobs:
            return inf
        return next(iter(self._jobs.values())).job.created_at + self._wait_s

    def predict_s(self, priority: Priority, deadline: float, num_steps: int, passes: int) -> float:
        del priority, deadline
        running = max((held.job.num_steps - held.steps_done for held in self._running()), default=0)
        waiting = len(self._jobs) - len(self._batch) + 1
        # Jobs of other shapes need separate batches: at least one for each waiting shape.
        batches = max(ceil(waiting / self._max_rows), len(set(self._shapes.values())))
        rounds = running + batches * num_steps
        return self._wait_s + self._window_s(rounds, ceil(waiting / batches), num_steps, passes)

    def _running(self) -> Sequence[ScheduledJob]:
        return [self._jobs[job_id] for job_id in self._batch]
