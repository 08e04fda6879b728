"""What the engine needs of whatever decides which windows are in the next denoising step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob
from motiongen_server.engine.types import Priority, RowStatus, WindowJob


class SchedulingPolicy(Protocol):
    """Decides which jobs are in the next denoising step. Holds every job from `add` to `remove`; never waits.

    Called from the engine's thread alone. `Scheduler` is the one that is served with; others can be measured in its
    place.
    """

    @property
    def costs(self) -> CostTable:
        """What calls of the runner cost; the engine keeps it up to date."""
        ...

    def __len__(self) -> int:
        """Jobs held."""
        ...

    def add(self, job: WindowJob, passes: int) -> None:
        """Take in a job. passes: what `Runner.num_passes` says of it."""
        ...

    def remove(self, job_id: int) -> None:
        """Let go of a job that is held, at any stage."""
        ...

    def exchange(self, job: WindowJob, passes: int) -> None:
        """Hold a job in place of the one with its number, which is not prepared; it may be of another class."""
        ...

    def schedule(self, now: float) -> Sequence[ScheduledJob]:
        """The jobs of the next step, most urgent first. Empty: none before `wake_at`, unless more comes."""
        ...

    @property
    def largest_step(self) -> int:
        """Evaluations of the largest step that it makes, however much there is to do."""
        ...

    def wake_at(self) -> float:
        """When to ask again though nothing has come; infinity: no need to."""
        ...

    def mark_prepared(self, job_ids: Iterable[int]) -> None:
        """Note that the runner holds these jobs."""
        ...

    def commit(self, statuses: Iterable[RowStatus]) -> list[int]:
        """Note the steps that were done; returns the jobs that have done all of theirs."""
        ...

    def predict_s(self, priority: Priority, deadline: float, num_steps: int, passes: int) -> float:
        """Seconds until a job that is added now would be finished, as things stand."""
        ...

    def left_s(self, held: ScheduledJob) -> float:
        """Seconds until a job that is in the next step will be finished, as things stand."""
        ...
