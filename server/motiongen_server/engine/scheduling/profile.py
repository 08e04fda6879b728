"""Profile: what calls of the runner cost at start-up, measured with windows that are thrown away.

It also proves, before anyone depends on it, that the model gives finite frames and that the device has the memory.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf

import numpy as np

from motiongen_server.engine.ports import Clock, OutOfMemory, Runner
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.trial_jobs import trial_job
from motiongen_server.engine.types import Float32Array, WindowJob, WindowResult

# Each size once to allocate and to build what is built for a size, then as often to time it. The least time counts:
# what others on the machine add to a call is no property of the call, and what it really costs is tracked later on.
_TIMES = 2


class UnsoundModel(ValueError):
    """The model cannot be served: it gives frames that are not finite, or does not fit the device even alone."""


@dataclass(frozen=True, slots=True)
class Profile:
    """costs: the table. max_rows: the most windows of a step that the device has memory for, within what was asked."""

    costs: CostTable
    max_rows: int


def profile(runner: Runner, clock: Clock, max_rows: int, history_frames: int, budget_s: float = 8.0) -> Profile:
    """Measure calls of 1, 2, 4, ... max_rows windows, as many of these sizes as budget_s allows.

    Raises UnsoundModel.
    """
    costs = CostTable.assumed(0.0)
    job_ids = itertools.count(-1, -1)  # never those of the engine
    ends_at = clock.now() + budget_s
    largest = 0
    history: Float32Array = np.zeros((0, runner.facts.feature_dim), np.float32)
    took_s = 0.0
    for size in _sizes(max_rows):
        # The next size takes about twice as long as this one did.
        if largest and clock.now() + 2 * took_s > ends_at:
            return Profile(costs, max_rows)
        begun_at = clock.now()
        try:
            least = _Least()
            for round_number in range(1 + _TIMES):
                jobs = [trial_job(runner.facts, next(job_ids), history) for _ in range(size)]
                results = _windows(runner, jobs, clock, least if round_number else _Least())
        except OutOfMemory as error:
            if not largest:
                raise UnsoundModel(
                    f"the model does not fit the device's memory even for one window: {error}"
                ) from error
            return Profile(costs, largest)
        least.observe(costs, size, sum(runner.num_passes(job) for job in jobs))
        if not largest:
            history = results[0].features[:history_frames]
        largest = size
        took_s = clock.now() - begun_at
    return Profile(costs, max_rows)


def _sizes(most: int) -> Iterator[int]:
    size = 1
    while size < most:
        yield size
        size *= 2
    yield most


@dataclass(slots=True)
class _Least:
    """The least seconds that each kind of call took."""

    prepare_s: float = inf
    step_s: float = inf
    decode_s: float = inf

    def observe(self, costs: CostTable, windows: int, evaluations: int) -> None:
        """Enter them into the table."""
        costs.prepare.observe(windows, self.prepare_s)
        costs.step.observe(evaluations, self.step_s)
        costs.decode.observe(windows, self.decode_s)


def _windows(runner: Runner, jobs: list[WindowJob], clock: Clock, least: _Least) -> list[WindowResult]:
    """Take the jobs through all their steps, and note what the calls took."""
    job_ids = [job.job_id for job in jobs]
    results: list[WindowResult] = []
    try:
        least.prepare_s = min(least.prepare_s, _timed(lambda: runner.prepare(jobs), clock))
        for _ in range(jobs[0].num_steps):
            least.step_s = min(least.step_s, _timed(lambda: runner.denoise(job_ids), clock))
        least.decode_s = min(least.decode_s, _timed(lambda: results.extend(runner.decode(job_ids)), clock))
    finally:
        runner.discard(job_ids)
    if not all(np.isfinite(result.frames).all() for result in results):
        raise UnsoundModel("the model gives frames that are not finite; its checkpoint is damaged")
    return results


def _timed(call: Callable[[], object], clock: Clock) -> float:
    """Seconds of a call."""
    begun_at = clock.now()
    call()
    return clock.now() - begun_at
