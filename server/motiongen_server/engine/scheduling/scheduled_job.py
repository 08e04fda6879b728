"""ScheduledJob: a window in the scheduler's care."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from motiongen_server.engine.types import RowStatus, WindowJob


@dataclass(slots=True)
class ScheduledJob:
    """passes: evaluations of a step. prepared: the runner holds it."""

    job: WindowJob
    passes: int = 1
    prepared: bool = False
    steps_done: int = 0

    def note(self, status: RowStatus) -> bool:
        """Note the steps that were done; returns whether those were all."""
        self.steps_done = status.steps_done
        return self.steps_done >= self.job.num_steps

    @property
    def dueness(self) -> tuple[float, int]:
        """What orders the jobs of a class."""
        return (self.job.deadline, self.job.job_id)

    def rank(self) -> tuple[int, float, int]:
        """What orders all jobs."""
        return (self.job.priority, *self.dueness)

    @property
    def urgency(self) -> tuple[float, int]:
        """What orders the jobs whose frames clients would run out of."""
        return (self.job.runs_out_at, self.job.job_id)

    @property
    def is_played(self) -> bool:
        """Whether it makes frames that a client would run out of."""
        return self.job.runs_out_at < inf
