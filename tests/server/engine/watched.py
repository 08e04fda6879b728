"""WatchedScheduler: the scheduler, with every step it hands out checked against what it promises."""

from __future__ import annotations

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob
from motiongen_server.engine.scheduling.scheduler import DEFAULT_SHARES, Scheduler
from motiongen_server.engine.types import Priority, WindowJob


class PromiseBroken(AssertionError):
    """The scheduler did what it says it never does."""


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise PromiseBroken(what)


class WatchedScheduler(Scheduler):
    """Keeps its own books of who is held, in order of due time, and of how long each class has waited.

    longest_wait: rows given to others, at the most, while a class with a share had jobs and got none.
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
            # Whose frames are endangered may come first; newcomers come last, and may wait to begin together.
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
        """A class that is owed a whole row gets it, though the whole rows of other classes may have to come first."""
        self._waited[priority] = 0 if taken or not held else self._waited[priority] + rows
        self.longest_wait[priority] = max(self.longest_wait[priority], self._waited[priority])
        share = DEFAULT_SHARES[priority - 1]
        if share:
            limit = 1 / share + 4 * self._most_rows
            waited = self._waited[priority]
            _require(waited <= limit, f"class {priority.name} has waited for {waited} rows, more than {limit:.0f}")


def _order(held: ScheduledJob) -> tuple[bool, tuple[float, int]]:
    """What jobs of a class are taken in order of."""
    return (not held.prepared, held.dueness)
