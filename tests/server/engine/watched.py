"""WatchedScheduler: the scheduler, with a check of every step against its guarantees."""

from __future__ import annotations

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob
from motiongen_server.engine.scheduling.scheduler import DEFAULT_SHARES, Scheduler
from motiongen_server.engine.types import Priority, WindowJob


class PromiseBroken(AssertionError):
    """The scheduler broke one of its guarantees."""


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise PromiseBroken(what)


class WatchedScheduler(Scheduler):
    """Records which jobs are held, in order of due time, and how long each class has waited.

    longest_wait: the most rows given to other classes while a class with a share had jobs and got no row.
    """

    def __init__(self, costs: CostTable, max_rows: int) -> None:
        super().__init__(costs, max_rows)
        self._most_rows = max_rows
        self._held: dict[int, WindowJob] = {}
        self._waited = dict.fromkeys(Priority, 0)
        self.longest_wait = dict.fromkeys(Priority, 0)

    def add(self, job: WindowJob, passes: int) -> None:
        _require(job.job_id not in self._held, f"job {job.job_id} added twice")
        self._held[job.job_id] = job
        super().add(job, passes)

    def remove(self, job_id: int) -> None:
        _require(job_id in self._held, f"job {job_id} removed, but not held")
        del self._held[job_id]
        super().remove(job_id)

    def schedule(self, now: float) -> list[ScheduledJob]:
        gathering = {priority for priority in Priority if self.gathers(priority)}
        batch = super().schedule(now)
        chosen = {held.job.job_id for held in batch}
        _require(len(chosen) == len(batch) <= self._most_rows, f"{len(batch)} rows of at most {self._most_rows}")
        _require(bool(batch) == bool(self._held), "nothing to do though jobs are held, or the reverse")
        _require(chosen <= self._held.keys(), "a job that is not held")
        _require(batch == sorted(batch, key=ScheduledJob.rank), "the rows are out of order")
        for priority in Priority:
            of_class = [held for held in self._jobs.values() if held.job.priority is priority]
            # Jobs whose frames are at risk may come first; new jobs come last, and may wait to start together.
            taken = [_order(held) for held in batch if held.job.priority is priority and not held.is_played]
            left = [
                _order(held)
                for held in of_class
                if held.job.job_id not in chosen and (held.prepared or priority not in gathering)
            ]
            in_order = not taken or not left or max(taken) < min(left)
            _require(in_order, f"class {priority.name} is out of order")
            num_taken = sum(held.job.priority is priority for held in batch)
            self._note_wait(priority, num_taken, len(batch), len(of_class))
        return batch

    def _note_wait(self, priority: Priority, taken: int, rows: int, held: int) -> None:
        """Check that a class that is owed a whole row gets it, after whole rows owed to other classes at most."""
        self._waited[priority] = 0 if taken or not held else self._waited[priority] + rows
        self.longest_wait[priority] = max(self.longest_wait[priority], self._waited[priority])
        share = DEFAULT_SHARES[priority - 1]
        if share:
            limit = 1 / share + 4 * self._most_rows
            waited = self._waited[priority]
            _require(waited <= limit, f"class {priority.name} has waited for {waited} rows, more than {limit:.0f}")


def _order(held: ScheduledJob) -> tuple[bool, tuple[float, int]]:
    """The sort key of a class's jobs."""
    return (not held.prepared, held.dueness)
