"""ScheduledJob: a window that the scheduler holds."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from motiongen_server.engine.types import RowStatus, WindowJob


@dataclass(slots=True)
class ScheduledJob:
    """A window and its progress. passes: evaluations per step. prepared: whether the runner holds it."""

    job: WindowJob
    passes: int = 1
    prepared: bool = False
    steps_done: int = 0

    def note(self, status: RowStatus) -> bool:
        """Record the steps that were done. Returns whether those were all."""
        self.steps_done = status.steps_done
        return self.steps_done >= self.job.num_steps

    @property
    def dueness(self) -> tuple[float, int]:
        """Sort key of the jobs within a class."""
        return (self.job.deadline, self.job.job_id)

    def rank(self) -> tuple[int, float, int]:
        """Sort key of all jobs."""
        return (self.job.priority, *self.dueness)

    @property
    def urgency(self) -> tuple[float, int]:
        """Sort key of the jobs with frames that clients would run out of."""
        return (self.job.runs_out_at, self.job.job_id)

    @property
    def is_played(self) -> bool:
        """Whether it makes frames that a client would run out of, or its first ones."""
        return self.job.runs_out_at < inf
