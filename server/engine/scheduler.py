"""Scheduler: which jobs are in the next denoising step, and what steps cost. Pure: time comes in as an argument.

Within a class the earliest deadline goes first; classes go in order of priority. When jobs are left over, one row of
the step goes to the earliest deadline of any class, so that no class starves.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from server.engine.types import Priority, RowStatus, WindowJob

_LEARNING_RATE = 0.125


class CostTable:
    """Seconds of one engine iteration by bucket of rows: a running mean, and a running mean deviation from it."""

    def __init__(self, initial_step_s: float) -> None:
        self._initial_step_s = initial_step_s
        self._means: dict[int, float] = {}
        self._deviations: dict[int, float] = {}

    @staticmethod
    def bucket(rows: int) -> int:
        """The power of two at or above rows."""
        return 1 << (rows - 1).bit_length()

    def observe(self, rows: int, seconds: float) -> None:
        bucket = self.bucket(rows)
        if bucket not in self._means:
            self._means[bucket], self._deviations[bucket] = seconds, 0.0
            return
        error = seconds - self._means[bucket]
        self._means[bucket] += _LEARNING_RATE * error
        self._deviations[bucket] += _LEARNING_RATE * (abs(error) - self._deviations[bucket])

    def window_s(self, rows: int, num_steps: int) -> float:
        """What num_steps iterations with so many rows will take, with two deviations on top.

        A bucket not measured yet is judged by the next greater one, else by the greatest in proportion to its rows.
        """
        if not self._means:
            return num_steps * self._initial_step_s
        bucket = self.bucket(rows)
        greater = [known for known in self._means if known >= bucket]
        known = min(greater) if greater else max(self._means)
        scale = max(1.0, bucket / known)
        return scale * (num_steps * self._means[known] + 2 * self._deviations[known])


@dataclass(slots=True)
class ScheduledJob:
    """A job in the scheduler's care. prepared: the runner holds it."""

    job: WindowJob
    prepared: bool = False
    steps_done: int = 0

    @property
    def urgency(self) -> tuple[Priority, float, int]:
        return (self.job.priority, self.job.deadline, self.job.job_id)

    @property
    def dueness(self) -> tuple[float, int]:
        return (self.job.deadline, self.job.job_id)


class Scheduler:
    """Holds every window job from `add` to `remove`. Jobs join, pause and leave between steps, at no cost."""

    def __init__(self, max_rows: int, initial_step_s: float) -> None:
        self._max_rows = max_rows
        self._jobs: dict[int, ScheduledJob] = {}
        self._num_by_class: Counter[Priority] = Counter()
        self.costs = CostTable(initial_step_s)

    def __len__(self) -> int:
        return len(self._jobs)

    def add(self, job: WindowJob) -> None:
        self._jobs[job.job_id] = ScheduledJob(job)
        self._num_by_class[job.priority] += 1

    def remove(self, job_id: int) -> None:
        held = self._jobs.pop(job_id)
        self._num_by_class[held.job.priority] -= 1

    def schedule(self) -> list[ScheduledJob]:
        """The jobs of the next step, most urgent first."""
        rows = heapq.nsmallest(self._max_rows, self._jobs.values(), key=lambda held: held.urgency)
        if len(rows) < len(self._jobs) and self._max_rows > 1:
            chosen = {held.job.job_id for held in rows[:-1]}
            others = (held for held in self._jobs.values() if held.job.job_id not in chosen)
            rows[-1] = min(others, key=lambda held: held.dueness)
        return rows

    def mark_prepared(self, job_ids: Iterable[int]) -> None:
        for job_id in job_ids:
            self._jobs[job_id].prepared = True

    def commit(self, statuses: Iterable[RowStatus]) -> list[int]:
        """Note the steps that were done; returns the jobs that have done all of theirs."""
        finished = []
        for status in statuses:
            held = self._jobs[status.job_id]
            held.steps_done = status.steps_done
            if held.steps_done >= held.job.num_steps:
                finished.append(status.job_id)
        return finished

    def predict_s(self, priority: Priority, num_steps: int) -> float:
        """Seconds until a job that is added now would be finished, as things stand."""
        rows = min(len(self._jobs) + 1, self._max_rows)
        ahead = 1 + sum(count for held, count in self._num_by_class.items() if held <= priority)
        rounds = max(1.0, ahead / self._max_rows)
        return self.costs.window_s(rows, math.ceil(num_steps * rounds))
