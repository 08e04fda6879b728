"""What a runner does if everything is known in advance: full batches of one shape, one after another, no real time.

This is the ceiling of what an engine can get out of it, and, by parts, what its calls cost.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from motiongen_server.engine.ports import Runner
from motiongen_server.engine.types import (
    Float32Array,
    Guidance,
    PlanCause,
    Priority,
    SessionKey,
    StartPose,
    WindowJob,
    WindowResult,
)
from tests.bench.clocks import BenchClock

HISTORY_FRAMES = 16
_job_ids = itertools.count(1 << 40)  # far from the ids of an engine that shares the runner


@dataclass(frozen=True)
class OfflineRate:
    """Median seconds of the three calls for one batch of `batch` windows."""

    batch: int
    num_steps: int
    passes: int
    prepare_s: float
    step_s: float
    decode_s: float

    @property
    def window_s(self) -> float:
        """Seconds that the whole batch takes."""
        return self.prepare_s + self.num_steps * self.step_s + self.decode_s

    @property
    def windows_per_s(self) -> float:
        return self.batch / self.window_s


def offline_rate(
    runner: Runner,
    batch: int,
    num_steps: int,
    embeddings: Sequence[Float32Array],
    *,
    seconds: float,
    clock: BenchClock,
    steps_run: int | None = None,
    synchronize: Callable[[], None] = lambda: None,
    keep_tokens: bool = True,
) -> OfflineRate:
    """Run windows that continue earlier ones, with a prompt and no constraints, for about so many seconds.

    steps_run: how many steps of each window are run; fewer give the same figures sooner. synchronize: waits for the
    device, if calls only start work. keep_tokens: use the tokens of the previous windows as histories.
    """
    nothing = np.empty((0, runner.facts.feature_dim), np.float32)
    jobs = [replace(first_job(number, num_steps, embeddings), history=nothing) for number in range(batch)]
    firsts = [_run(runner, [job], num_steps, clock, synchronize)[0][0] for job in jobs[:1]] * batch
    until = clock.now() + seconds
    times: list[tuple[float, list[float], float]] = []
    while len(times) < 2 or (clock.now() < until):
        plan = 2 + len(times)
        later = [later_job(number, num_steps, embeddings, first, plan) for number, first in enumerate(firsts)]
        if not keep_tokens:
            later = [replace(job, history_tokens=None) for job in later]
        times.append(_run(runner, later, steps_run or num_steps, clock, synchronize)[1:])
    if len(times) > 2:
        times = times[1:]  # the first batch of a size also allocates its memory
    return OfflineRate(
        batch,
        num_steps,
        runner.num_passes(later[0]),
        median(prepare_s for prepare_s, _, _ in times),
        median(step_s for _, steps, _ in times for step_s in steps),
        median(decode_s for _, _, decode_s in times),
    )


def _run(
    runner: Runner, jobs: Sequence[WindowJob], num_steps: int, clock: BenchClock, synchronize: Callable[[], None]
) -> tuple[list[WindowResult], float, list[float], float]:
    """Run a batch. Returns the results, and the seconds of prepare, each step, and decode."""
    ids = [job.job_id for job in jobs]
    synchronize()
    stamps = [clock.now()]
    runner.prepare(jobs)
    for call in range(num_steps + 1):
        synchronize()
        stamps.append(clock.now())
        if call < num_steps:
            runner.denoise(ids)
    results = runner.decode(ids)
    synchronize()
    stamps.append(clock.now())
    spans = [later - earlier for earlier, later in itertools.pairwise(stamps)]
    return results, spans[0], spans[1:-1], spans[-1]


def first_job(number: int, num_steps: int, embeddings: Sequence[Float32Array]) -> WindowJob:
    """A session's first window, with a prompt and no constraints; its history is empty, with a width of 0."""
    return WindowJob(
        job_id=next(_job_ids),
        session=SessionKey(0, number),
        plan=1,
        first_frame=0,
        history=np.empty((0, 0), np.float32),
        start_pose=StartPose(),
        embedding=embeddings[number % len(embeddings)],
        constraints=(),
        seed=number,
        num_steps=num_steps,
        guidance=Guidance(2.0, 2.0),
        deadline=0.0,
        priority=Priority.NEAR,
        cause=PlanCause.CONTINUE,
        created_at=0.0,
    )


def later_job(
    number: int, num_steps: int, embeddings: Sequence[Float32Array], earlier: WindowResult, plan: int = 2
) -> WindowJob:
    """The window after another, with that one's tokens as history if the runner keeps them."""
    tokens = None if earlier.tokens is None else earlier.tokens[-HISTORY_FRAMES // 4 :]
    return replace(
        first_job(number, num_steps, embeddings),
        plan=plan,
        first_frame=len(earlier.features),
        history=earlier.features[-HISTORY_FRAMES:],
        start_pose=None,
        history_tokens=tokens,
    )
