"""StepLimits: how large a denoising step is made, with time to spare and without."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob

# Steps are not made smaller for a deadline than the size at which a row costs so many times its least: with time to
# spare, and where what is held fills more than such a share of the time until it is due. Late jobs count as due soon.
_MOST_WASTE, _LITTLE_WASTE = 2.0, 1.15
# Then, too, steps may be so many times longer than they should: to be on time matters more than to answer soon.
_STRAINED_SHARE = 0.5
_STRAINED_STRETCH = 2.0
_SOON_S = 0.25
# With time to spare no more windows begin and end together than so long is taken for, besides their steps; but as many
# as these in any case. On a GPU steps of many more take hardly longer, but preparing, decoding and what the engine does
# for each do, and an edit that comes meanwhile waits for all of it, and then for its own turn.
_UNHURRIED_S, _UNHURRIED_ROWS = 0.02, 32


class StepLimits:
    """Of the steps of one engine.

    max_rows, max_evaluations: in any case. max_step_s: what a step should take at most.
    """

    def __init__(self, costs: CostTable, max_rows: int, max_evaluations: int, max_step_s: float) -> None:
        self.max_evaluations = max_evaluations
        self._costs = costs
        self._max_rows = max_rows
        self._max_step_s = max_step_s

    def most_rows(self, strained: bool) -> int:
        """Most windows of a step."""
        costs = self._costs
        besides_s = sum(call.each_s(self._max_rows) for call in (costs.prepare, costs.decode)) + costs.own_each_s
        if strained or self._max_rows * besides_s <= _UNHURRIED_S:
            return self._max_rows
        return min(self._max_rows, max(_UNHURRIED_ROWS, int(_UNHURRIED_S / besides_s)))

    def most_evaluations(self, strained: bool) -> int:
        """Most evaluations of a step."""
        if self._max_step_s == inf:
            return self.max_evaluations
        allowed_s = self._max_step_s * (_STRAINED_STRETCH if strained else 1.0)
        within = max(self._costs.step.largest_within(allowed_s), self.least_evaluations(strained=False))
        return min(self.max_evaluations, within)

    def least_evaluations(self, strained: bool) -> int:
        """A step is not made smaller than this for a deadline."""
        waste = _LITTLE_WASTE if strained else _MOST_WASTE
        return self._costs.step.efficient_from(self.max_evaluations, waste)

    def are_strained(self, jobs: Iterable[ScheduledJob], now: float) -> bool:
        """Whether there is no time to waste, if all that is held shall be done when it is due.

        jobs: those that somebody waits for, by class, and in order of deadline.
        """
        each_s, own_s = self._costs.step.each_s(self.max_evaluations), self._costs.own_each_s
        work_s = 0.0
        for held in jobs:
            work_s += each_s * held.passes * (held.job.num_steps - held.steps_done) + own_s
            if work_s > _STRAINED_SHARE * max(held.job.deadline - now, _SOON_S):
                return True
        return False
