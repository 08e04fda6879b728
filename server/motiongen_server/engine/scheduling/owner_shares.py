"""OwnerShares: reserves rows of the next step for owners, regardless of the classes and deadlines of others' jobs.

An owner has a share of the rows of every step, by its weight among the owners that have jobs. While there is more work
than can be done in good time, it gets at least that, if it has enough jobs; among its own jobs, class and deadline
decide. What an owner does not use goes to the others.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice

from motiongen_server.engine.scheduling.owed_rows import OwedRows
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob


@dataclass(slots=True)
class _Account:
    """One owner's jobs; queue: their ranks in order of class and deadline. weight: as of its latest job."""

    weight: float
    jobs: dict[int, ScheduledJob] = field(default_factory=dict)
    queue: list[tuple[int, float, int]] = field(default_factory=list)


class OwnerShares:
    """Knows all jobs that somebody plays; background jobs take what is left, whoever owns them."""

    def __init__(self) -> None:
        self._accounts: dict[str, _Account] = {}
        self._owed: OwedRows[str] = OwedRows()

    @property
    def are_several(self) -> bool:
        """Whether more than one owner has jobs."""
        return len(self._accounts) > 1

    def add(self, held: ScheduledJob) -> None:
        job = held.job
        if not job.background:
            account = self._accounts.setdefault(job.owner.name, _Account(job.owner.weight))
            account.weight = job.owner.weight
            account.jobs[job.job_id] = held
            insort(account.queue, held.rank())

    def remove(self, held: ScheduledJob) -> None:
        job = held.job
        if not job.background:
            account = self._accounts[job.owner.name]
            del account.jobs[job.job_id]
            del account.queue[bisect_left(account.queue, held.rank())]
            if not account.jobs:
                del self._accounts[job.owner.name]

    def reserved(self, may_run: Callable[[ScheduledJob], bool]) -> Iterator[ScheduledJob]:
        """The jobs reserved for this step: as many as the whole rows that owners are owed, the most owed first."""
        for name, rows in self._owed.whole():
            account = self._accounts.get(name)
            if account is not None:
                ready = (held for *_, job_id in account.queue if may_run(held := account.jobs[job_id]))
                yield from islice(ready, rows)

    def settle(self, chosen: Iterable[ScheduledJob], strained: bool) -> None:
        """Update what is owed after a step. strained: there is more work than can be done in good time."""
        if not (strained and self.are_several):
            self._owed.forget()
            return
        taken = Counter(held.job.owner.name for held in chosen if not held.job.background)
        total = sum(account.weight for account in self._accounts.values())
        shares = {name: account.weight / total for name, account in self._accounts.items()}
        # Owners that got all they asked for are included too: their jobs need further steps.
        self._owed.settle(taken.total(), shares, taken, shares)
