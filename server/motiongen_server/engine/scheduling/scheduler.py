"""Scheduler: chooses the jobs of the next denoising step. Pure: time is passed as an argument.

Frames that a client would run out of precede anything that only changes frames: a window without which a client's
frames end soon comes first, whatever its class and cause, and so does a first window that has waited for long. Then
classes go in order of priority, but each has a reserved share of all rows: while jobs of a class are left over, it gets
a row at the latest when it is owed a whole one, so that no class starves. Windows that have missed their deadlines are
taken with those of the most urgent class, and those of their class that have begun with them (ADR 105). Within a class,
windows that have begun go first, then the earliest deadline. Owners have shares of the same kind (`owner_shares`).
Background jobs come after all classes, whatever class they have themselves, and have a share like a class: nobody waits
for them, and none of them waits for ever.

Preparing and decoding cost little more for several windows than for one. So new windows gather: if the running windows
of their class, or these and those of more urgent classes, will soon be done, they wait for them and begin together.

A step is as large as the limits and the tightest deadline allow; windows of that deadline's class that have begun are
included even beyond that, since a group that falls apart is decoded in parts. Jobs pause and continue between steps at
no cost.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from math import ceil, inf

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.owed_rows import OwedRows
from motiongen_server.engine.scheduling.owner_shares import OwnerShares
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob
from motiongen_server.engine.scheduling.step_limits import StepLimits
from motiongen_server.engine.types import Priority, RowStatus, WindowJob

DEFAULT_SHARES = (0.0, 0.15, 0.1, 0.05)
DEFAULT_BACKGROUND_STEP_S = 0.025
# Background jobs make a step with other jobs at most this many times as long.
_BACKGROUND_DRAG = 1.2
# Frames are endangered if the time left is at most this many times what their window still takes in steps of the
# largest size. More under a quota, where the processor may stand still meanwhile (ADR 90).
_ENDANGERED, _ENDANGERED_UNDER_QUOTA = 2.0, 4.0
# New windows wait at most this long for running ones of their class to be done, and only this share of it for these and
# those of more urgent classes together, some of which may be nearly done at all times.
DEFAULT_GATHER_S = 0.12
_BEHIND_OTHERS = 0.5
# The background's place, after those of all classes.
_BACKGROUND = len(Priority)


class Scheduler:
    """Holds every window job from `add` to `remove`.

    max_rows, max_evaluations: of one step. max_step_s: no step is made longer than this, so that a job that arrives
    meanwhile need not wait longer; background_step_s: the same for a step with background jobs only. shares: of all
    rows, reserved for each class, most urgent first; the last one also applies to the background. gather_s: how long
    new windows wait for others of their class at most. under_quota: processor time is limited by a quota, without which
    all calls stop.
    """

    def __init__(
        self,
        costs: CostTable,
        max_rows: int,
        *,
        max_evaluations: int | None = None,
        max_step_s: float = inf,
        background_step_s: float = DEFAULT_BACKGROUND_STEP_S,
        shares: Sequence[float] = DEFAULT_SHARES,
        gather_s: float = DEFAULT_GATHER_S,
        under_quota: bool = False,
    ) -> None:
        self.costs = costs
        self._max_rows = max_rows
        self._limits = StepLimits(costs, max_rows, max_evaluations or 3 * max_rows, max_step_s)
        self._background_step_s = background_step_s
        self._shares = dict(enumerate((*shares, shares[-1])))
        self._gather_s = gather_s
        self._endangered_times = _ENDANGERED_UNDER_QUOTA if under_quota else _ENDANGERED
        self._jobs: dict[int, ScheduledJob] = {}
        # One queue per class, and the background's after them, indexed by `_place`.
        self._queues: tuple[list[tuple[float, int]], ...] = tuple([] for _ in range(_BACKGROUND + 1))
        self._evaluations = [0 for _ in self._queues]
        self._played: list[tuple[float, int]] = []
        self._played_steps: Counter[int] = Counter()  # how many of these windows have each num_steps
        self._cap = self._limits.max_evaluations  # most evaluations of the last step
        self._owed: OwedRows[int] = OwedRows()
        self._owners = OwnerShares()

    def __len__(self) -> int:
        return len(self._jobs)

    def add(self, job: WindowJob, passes: int) -> None:
        held = self._jobs[job.job_id] = ScheduledJob(job, passes)
        self._file(held)

    def remove(self, job_id: int) -> None:
        self._unfile(self._jobs.pop(job_id))

    def exchange(self, job: WindowJob, passes: int) -> None:
        held = self._jobs[job.job_id]
        self._unfile(held)  # its class may be another one by now
        held.job, held.passes = job, passes
        self._file(held)

    def _file(self, held: ScheduledJob) -> None:
        place = _place(held.job)
        insort(self._queues[place], held.dueness)
        if held.is_played:
            insort(self._played, held.urgency)
            self._played_steps[held.job.num_steps] += 1
        self._owners.add(held)
        self._evaluations[place] += held.passes

    def _unfile(self, held: ScheduledJob) -> None:
        place = _place(held.job)
        queue = self._queues[place]
        del queue[bisect_left(queue, held.dueness)]
        if held.is_played:
            del self._played[bisect_left(self._played, held.urgency)]
            self._played_steps[held.job.num_steps] -= 1
            if not self._played_steps[held.job.num_steps]:
                del self._played_steps[held.job.num_steps]
        self._owners.remove(held)
        self._evaluations[place] -= held.passes

    def schedule(self, now: float) -> list[ScheduledJob]:
        """The jobs of the next step, most urgent first."""
        strained = self._strained(now)
        limits, most_rows = self._limits, self._limits.most_rows(strained)
        budget_s, most, least = inf, limits.most_evaluations(strained), limits.least_evaluations(strained)
        budget_of: Priority | None = None
        self._cap = most
        chosen = self._reserved(most, strained)
        evaluations = sum(held.passes for held in chosen.values())
        room_s: float | None = None  # how long the step may become by background jobs; set once one is considered
        for held in self._candidates(now):
            if held.job.job_id in chosen:
                continue
            larger = evaluations + held.passes
            step_s = self.costs.step.seconds(larger)
            full = len(chosen) >= most_rows or (chosen and larger > most)
            too_long = step_s > budget_s and larger > least
            if full or (too_long and not (held.prepared and held.job.priority is budget_of)):
                break
            if held.job.background:
                room_s = self._background_room_s(chosen.values(), evaluations) if room_s is None else room_s
                if chosen and step_s > room_s:
                    break  # all after it are background jobs, too
            allowed_s = self._allowed_step_s(held, now)
            if step_s <= allowed_s < budget_s:  # else it will be late anyway, and the step need not be smaller for it
                budget_s, budget_of = allowed_s, held.job.priority
            chosen[held.job.job_id], evaluations = held, larger
        return self._commit_rows(chosen, strained)

    def _candidates(self, now: float) -> Iterator[ScheduledJob]:
        """The jobs that may be in the next step, in the order in which they are considered; some come twice."""
        yield from self._endangered(now)
        places = [place for place, queue in enumerate(self._queues) if queue]
        late = [held for place in places[1:] for held in self._late(place, now)]
        for place in places:
            gathers = self._gathers(place)
            yield from (held for held in self._at(place, late) if held.prepared or not gathers)
            late = []

    def _late(self, place: int, now: float) -> list[ScheduledJob]:
        """If jobs of a class have missed their deadlines: these and those that have begun. None of the background."""
        if place == _BACKGROUND or self._queues[place][0][0] >= now:
            return []
        held = (self._jobs[job_id] for _, job_id in self._queues[place])
        return [one for one in held if one.prepared or one.job.deadline < now]

    def _at(self, place: int, others: Sequence[ScheduledJob] = ()) -> list[ScheduledJob]:
        """The jobs of a class, or of the background, and others: first those that have begun, then by deadline."""
        held = (self._jobs[job_id] for _, job_id in self._queues[place])
        return sorted((*held, *others), key=lambda one: (not one.prepared, one.dueness))

    def _endangered(self, now: float) -> list[ScheduledJob]:
        """Windows whose frames clients are about to run out of, in order of class and deadline."""
        step_s = self.costs.step.seconds(self.largest_step)
        window_s = self.costs.prepare.seconds(1) + self.costs.decode.seconds(1)
        # The search ends at the first job that would not be endangered even with the most steps of all. Before that, a
        # job of few steps may be safe although a later one of many is endangered: each is checked with its own.
        most_s = window_s + step_s * max(self._played_steps, default=0)
        endangered = []
        for runs_out_at, job_id in self._played:
            time_s = (runs_out_at - now) / self._endangered_times
            if time_s > most_s:
                break
            held = self._jobs[job_id]
            if time_s <= window_s + step_s * (held.job.num_steps - held.steps_done):
                endangered.append(held)
        return sorted(endangered, key=ScheduledJob.rank)

    def gathers(self, priority: Priority) -> bool:
        """Whether new windows of a class wait for running ones, of it or more urgent ones, that will soon be done."""
        return self._gathers(priority - 1)

    def _gathers(self, place: int) -> bool:
        begun = [
            [held for _, job_id in queue if (held := self._jobs[job_id]).prepared]
            for queue in self._queues[: place + 1]
        ]
        own, ahead = begun[-1], list(chain.from_iterable(begun))
        return self._are_done_in(own, self._gather_s) or self._are_done_in(ahead, _BEHIND_OTHERS * self._gather_s)

    def _are_done_in(self, begun: Sequence[ScheduledJob], seconds: float) -> bool:
        """Whether there are windows and all of them will be done within this time."""
        if not begun:
            return False
        step_s = self.costs.step.seconds(sum(held.passes for held in begun))
        rounds = max(held.job.num_steps - held.steps_done for held in begun)
        return rounds * step_s + self.costs.decode.seconds(len(begun)) <= seconds

    def _background_room_s(self, chosen: Iterable[ScheduledJob], evaluations: int) -> float:
        """How long background jobs may make a step: its other jobs wait for it, or else those that arrive meanwhile."""
        if any(not held.job.background for held in chosen):
            return _BACKGROUND_DRAG * self.costs.step.seconds(evaluations)
        return self._background_step_s

    def wake_at(self) -> float:
        """Infinity: jobs are never held back."""
        return inf

    def _reserved(self, most: int, strained: bool) -> dict[int, ScheduledJob]:
        """The jobs reserved in this step for classes and the background, then for owners, up to `most` evaluations."""
        chosen: dict[int, ScheduledJob] = {}
        evaluations = 0
        of_classes = (held for place, rows in self._owed.whole() for held in self._at(place)[:rows])
        for held in chain(of_classes, self._of_owners() if strained else ()):
            if held.job.job_id in chosen:
                continue
            evaluations += held.passes
            if len(chosen) >= self._max_rows or (chosen and evaluations > most):
                break
            chosen[held.job.job_id] = held
        return chosen

    def _of_owners(self) -> Iterable[ScheduledJob]:
        """The jobs reserved for owners."""
        if not self._owners.are_several:
            return ()
        gathering = {priority: self.gathers(priority) for priority in Priority}
        return self._owners.reserved(lambda held: held.prepared or not gathering[held.job.priority])

    def _commit_rows(self, chosen: dict[int, ScheduledJob], strained: bool) -> list[ScheduledJob]:
        """Update what is owed, and return the rows in order of class and deadline."""
        taken = Counter(_place(held.job) for held in chosen.values())
        waiting = [place for place, queue in enumerate(self._queues) if len(queue) > taken[place]]
        self._owed.settle(len(chosen), self._shares, taken, waiting)
        self._owners.settle(chosen.values(), strained)
        return sorted(chosen.values(), key=ScheduledJob.rank)

    @property
    def largest_step(self) -> int:
        """Evaluations of a step when there is a backlog."""
        return self._limits.most_evaluations(strained=True)

    def _strained(self, now: float) -> bool:
        held = (self._jobs[job_id] for queue in self._queues[:_BACKGROUND] for _, job_id in queue)
        return self._limits.are_strained(held, now)

    def _allowed_step_s(self, held: ScheduledJob, now: float) -> float:
        """How long each step of a job may take for the job to meet its deadline."""
        costs = self.costs
        rest_s = costs.decode.seconds(1) + (0.0 if held.prepared else costs.prepare.seconds(1))
        return (held.job.deadline - now - rest_s) / max(1, held.job.num_steps - held.steps_done)

    def mark_prepared(self, job_ids: Iterable[int]) -> None:
        for job_id in job_ids:
            self._jobs[job_id].prepared = True

    def commit(self, statuses: Iterable[RowStatus]) -> list[int]:
        """Record the steps that were done. Returns the jobs that have done all of theirs."""
        return [status.job_id for status in statuses if self._jobs[status.job_id].note(status)]

    def predict_s(self, priority: Priority, deadline: float, num_steps: int, passes: int) -> float:
        """Seconds until a job added now would be finished, judged by the current state."""
        queue = self._queues[priority - 1]
        in_class = self._evaluations[priority - 1]
        ahead = sum(self._evaluations[: priority - 1]) + passes
        if queue:
            ahead += in_class * bisect_left(queue, (deadline, 0)) // len(queue)
        cap = self._limits.most_evaluations(strained=False)
        evaluations = min(sum(self._evaluations[:_BACKGROUND]) + passes, cap)
        rows = min(len(self._jobs) + 1, self._max_rows)
        rounds = ceil(num_steps * max(1.0, ahead / cap))
        return self.costs.window_s(num_steps, rounds, evaluations, rows)

    def left_s(self, held: ScheduledJob) -> float:
        foreground = max(held.passes, sum(self._evaluations[:_BACKGROUND]))
        each = foreground / len(self._jobs)
        rows = max(1, min(len(self._jobs), self._max_rows, int(self._cap / each)))
        num_steps = held.job.num_steps
        return self.costs.window_s(num_steps, num_steps - held.steps_done, ceil(rows * each), rows)


def _place(job: WindowJob) -> int:
    """The index of the queue in which a job waits."""
    return _BACKGROUND if job.background else job.priority - 1
