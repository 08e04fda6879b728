"""SchedulingPolicy: what the engine needs of a scheduler."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob
from motiongen_server.engine.types import Priority, RowStatus, WindowJob


class SchedulingPolicy(Protocol):
    """Decides which jobs are in the next denoising step. Holds every job from `add` to `remove`; never waits.

    Called from the engine's thread only. The server uses `Scheduler`; others can be measured in its place.
    """

    @property
    def costs(self) -> CostTable:
        """What calls of the runner cost; the engine keeps it up to date."""
        ...

    def __len__(self) -> int:
        """Jobs held."""
        ...

    def add(self, job: WindowJob, passes: int) -> None:
        """Add a job. passes: the result of `Runner.num_passes` for it."""
        ...

    def remove(self, job_id: int) -> None:
        """Remove a job at any stage."""
        ...

    def exchange(self, job: WindowJob, passes: int) -> None:
        """Replace the job with the same number, which is not prepared yet; the class may differ."""
        ...

    def schedule(self, now: float) -> Sequence[ScheduledJob]:
        """The jobs of the next step, most urgent first. Empty: none before `wake_at`, unless a job is added."""
        ...

    @property
    def largest_step(self) -> int:
        """Evaluations of the largest step that it makes, however much work there is."""
        ...

    def wake_at(self) -> float:
        """When to ask again although nothing came; infinity: no need to."""
        ...

    def mark_prepared(self, job_ids: Iterable[int]) -> None:
        """Note that the runner holds these jobs."""
        ...

    def commit(self, statuses: Iterable[RowStatus]) -> list[int]:
        """Record the steps that were done. Returns the jobs that have done all of theirs."""
        ...

    def predict_s(self, priority: Priority, deadline: float, num_steps: int, passes: int) -> float:
        """Seconds until a job added now would be finished, judged by the current state."""
        ...

    def left_s(self, held: ScheduledJob) -> float:
        """Seconds until a job of the next step will be finished, judged by the current state."""
        ...
