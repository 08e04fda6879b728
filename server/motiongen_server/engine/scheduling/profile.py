"""Profile: measures what calls of the runner cost at start-up, with windows that are thrown away.

It also shows, before sessions depend on it, that the model makes finite frames and that the device has the memory.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from math import inf

import numpy as np

from motiongen_server.engine.ports import Clock, OutOfMemory, Runner
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.trial_jobs import plain_job, trial_job
from motiongen_server.engine.types import Float32Array, ModelFacts, WindowJob, WindowResult

# How often each size runs. The least time counts: what is allocated and built per size is paid for by the first run,
# and delays by others on the machine are no property of the call; the real cost is tracked later.
_TIMES = 3

_MakeJob = Callable[[ModelFacts, int, Float32Array], WindowJob]


class UnsoundModel(ValueError):
    """The model cannot be served: its frames are not finite, or it does not fit the device even with one window."""


@dataclass(frozen=True, slots=True)
class Profile:
    """costs: the table. max_rows: the most windows in a step that fit the device's memory, up to what was asked for."""

    costs: CostTable
    max_rows: int


def profile(
    runner: Runner,
    clock: Clock,
    max_rows: int,
    history_frames: int,
    budget_s: float = 8.0,
    turn: AbstractContextManager[object] | None = None,
) -> Profile:
    """Measure calls of 1, 2, 4, ... max_rows windows, as many of these sizes as budget_s allows.

    Steps with fewer evaluations than one of the dearest windows takes are measured with windows that take one
    evaluation each: otherwise the cost of a lone character would be learned from its first step, even if that was
    delayed.

    turn: entered for every call of the runner, where others use the device too; waiting for it is not measured. Raises
    UnsoundModel.
    """
    costs = CostTable.assumed(0.0)
    timer = _Timer(clock, turn or nullcontext())
    job_ids = itertools.count(-1, -1)  # never those of the engine
    ends_at = clock.now() + budget_s
    largest = 0
    history: Float32Array = np.zeros((0, runner.facts.feature_dim), np.float32)
    took_s = 0.0
    for size, make in _trials(runner, max_rows):
        is_plain = make is plain_job
        # The next size takes about twice as long as this one did.
        if size > 1 and clock.now() + 2 * took_s > ends_at:
            if is_plain:
                continue
            return Profile(costs, max_rows)
        begun_at = clock.now()
        try:
            least = _Least()
            for _ in range(_TIMES):
                jobs = [make(runner.facts, next(job_ids), history) for _ in range(size)]
                results = _windows(runner, jobs, timer, least)
        except OutOfMemory as error:
            if size == 1:
                raise UnsoundModel(
                    f"the model does not fit the device's memory even for one window: {error}"
                ) from error
            if is_plain:
                continue
            return Profile(costs, largest)
        costs.step.begin(sum(runner.num_passes(job) for job in jobs), least.step_s)
        if not is_plain:
            costs.prepare.begin(size, least.prepare_s)
            costs.decode.begin(size, least.decode_s)
            largest = size
        if not len(history):
            history = results[0].features[:history_frames]
        took_s = clock.now() - begun_at
    return Profile(costs, max_rows)


def _trials(runner: Runner, max_rows: int) -> Iterator[tuple[int, _MakeJob]]:
    """How many windows of which kind to try, by rising evaluations."""
    nothing: Float32Array = np.zeros((0, runner.facts.feature_dim), np.float32)
    dearest = runner.num_passes(trial_job(runner.facts, -1, nothing))
    if runner.num_passes(plain_job(runner.facts, -1, nothing)) < dearest:
        yield from ((size, plain_job) for size in _sizes(max_rows) if size < dearest)
    yield from ((size, trial_job) for size in _sizes(max_rows))


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


@dataclass(frozen=True, slots=True)
class _Timer:
    """Makes calls in turn with others, and measures them from when the turn has come."""

    clock: Clock
    turn: AbstractContextManager[object]

    def __call__(self, call: Callable[[], object]) -> float:
        """Seconds that a call took."""
        with self.turn:
            begun_at = self.clock.now()
            call()
            return self.clock.now() - begun_at


def _windows(runner: Runner, jobs: list[WindowJob], timer: _Timer, least: _Least) -> list[WindowResult]:
    """Compute the jobs from start to end, and record the times of the calls."""
    job_ids = [job.job_id for job in jobs]
    results: list[WindowResult] = []
    try:
        least.prepare_s = min(least.prepare_s, timer(lambda: runner.prepare(jobs)))
        for _ in range(jobs[0].num_steps):
            least.step_s = min(least.step_s, timer(lambda: runner.denoise(job_ids)))
        least.decode_s = min(least.decode_s, timer(lambda: results.extend(runner.decode(job_ids))))
    finally:
        timer(lambda: runner.discard(job_ids))
    if not all(np.isfinite(result.frames).all() for result in results):
        raise UnsoundModel("the model gives frames that are not finite; its checkpoint is damaged")
    return results
