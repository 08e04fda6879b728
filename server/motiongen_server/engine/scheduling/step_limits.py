"""StepLimits: how large a denoising step may be, with time to spare and without."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob

# A step is never made smaller for a deadline than the size at which a row costs this many times its least: the first
# with time to spare, the second under strain.
_MOST_WASTE, _LITTLE_WASTE = 2.0, 1.15
# Strain: the work held fills more than this share of the time until it is due; late jobs count as due in _SOON_S. Steps
# may then take _STRAINED_STRETCH times as long as they should: being on time matters more than a quick answer.
_STRAINED_SHARE = 0.5
_STRAINED_STRETCH = 2.0
_SOON_S = 0.25
# With time to spare, a step has only as many windows as take _UNHURRIED_S in total apart from the step itself, but
# up to _UNHURRIED_ROWS in any case. On a GPU, steps with many more hardly take longer, but preparing, decoding and the
# engine's own work for each do, and an edit that comes meanwhile waits for all of that before its own turn.
_UNHURRIED_S, _UNHURRIED_ROWS = 0.02, 32


class StepLimits:
    """Limits of one engine's steps.

    max_rows, max_evaluations: hard limits. max_step_s: how long a step should take at most.
    """

    def __init__(self, costs: CostTable, max_rows: int, max_evaluations: int, max_step_s: float) -> None:
        self.max_evaluations = max_evaluations
        self._costs = costs
        self._max_rows = max_rows
        self._max_step_s = max_step_s

    def most_rows(self, strained: bool) -> int:
        """Most windows in a step."""
        costs = self._costs
        besides_s = sum(call.each_s(self._max_rows) for call in (costs.prepare, costs.decode)) + costs.own_each_s
        if strained or self._max_rows * besides_s <= _UNHURRIED_S:
            return self._max_rows
        return min(self._max_rows, max(_UNHURRIED_ROWS, int(_UNHURRIED_S / besides_s)))

    def most_evaluations(self, strained: bool) -> int:
        """Most evaluations in a step."""
        if self._max_step_s == inf:
            return self.max_evaluations
        allowed_s = self._max_step_s * (_STRAINED_STRETCH if strained else 1.0)
        within = max(self._costs.step.largest_within(allowed_s), self.least_evaluations(strained=False))
        return min(self.max_evaluations, within)

    def least_evaluations(self, strained: bool) -> int:
        """The size below which a step is not reduced for a deadline."""
        waste = _LITTLE_WASTE if strained else _MOST_WASTE
        return self._costs.step.efficient_from(self.max_evaluations, waste)

    def are_strained(self, jobs: Iterable[ScheduledJob], now: float) -> bool:
        """Whether there is no time to waste if all jobs are to be done by their deadlines.

        jobs: those that somebody waits for, by class, and within a class by deadline.
        """
        each_s, own_s = self._costs.step.each_s(self.max_evaluations), self._costs.own_each_s
        work_s = 0.0
        for held in jobs:
            work_s += each_s * held.passes * (held.job.num_steps - held.steps_done) + own_s
            if work_s > _STRAINED_SHARE * max(held.job.deadline - now, _SOON_S):
                return True
        return False
