"""Runners that advance a virtual clock by what a model's calls would take; one of them computes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from motiongen_server.engine.ports import Runner
from motiongen_server.engine.scheduling.quota_share import QuotaAccount
from motiongen_server.engine.types import Float32Array, ModelFacts, RowStatus, WindowJob, WindowResult
from tests.bench.null_runner import NullRunner


@dataclass(frozen=True)
class Costs:
    """Seconds that calls take: (per call, per row). goals_s: additional seconds per row that has constraints.

    slower: a factor on all of them; slows: (from this second on, a further factor).
    The numbers are for the built-in model in float32 on one thread of an AMD Zen 5, measured once (`docs/log.md`).
    """

    prepare: tuple[float, float] = (0.0033, 0.0005)
    step: tuple[float, float] = (0.0042, 0.00135)
    decode: tuple[float, float] = (0.0065, 0.0019)
    goals_s: float = 0.001
    slower: float = 1.0
    slows: tuple[float, float] = (inf, 1.0)

    def seconds(self, of: tuple[float, float], rows: int) -> float:
        return self.slower * (of[0] + of[1] * rows)


class VirtualClock:
    """Time that passes only when the model is called."""

    def __init__(self) -> None:
        self.time_s = 1000.0

    def now(self) -> float:
        return self.time_s


class VirtualQuota:
    """A quota of CPU time, as the kernel grants it: in each period of 100 ms, full speed until it is used up."""

    def __init__(self, cores: float, period_s: float = 0.1) -> None:
        self._cores, self._period_s = cores, period_s
        self._period, self._left_s = -1, 0.0
        self._spent_s = 0.0

    @property
    def account(self) -> QuotaAccount:
        """The quota account of an engine that has this quota to itself."""
        return QuotaAccount(self._cores, 1, lambda: self._spent_s / self._cores, lambda: self._spent_s)

    def ends_at(self, now: float, processor_s: float) -> float:
        """When a call that begins now and takes so much CPU time ends."""
        while True:
            period = int(now / self._period_s)
            if period != self._period:
                self._period, self._left_s = period, self._cores * self._period_s
            next_at = (period + 1) * self._period_s
            runs_s = min(processor_s, self._left_s, next_at - now)
            self._left_s -= runs_s
            self._spent_s += runs_s
            processor_s -= runs_s
            if processor_s <= 0.0:
                return now + runs_s
            now = next_at + 1e-9


class CostedRunner(NullRunner):
    """Computes nothing, but takes the time that its calls cost. quota: what it may use of a core; None: all."""

    def __init__(self, clock: VirtualClock, costs: Costs, quota: VirtualQuota | None = None) -> None:
        super().__init__()
        self._clock, self._costs, self._quota = clock, costs, quota
        self._slows_at = clock.now() + costs.slows[0]
        self.steps = self.steps_thrown_away = 0
        self._jobs: dict[int, WindowJob] = {}

    def _take(self, seconds: float) -> None:
        now = self._clock.time_s
        seconds *= self._costs.slows[1] if now >= self._slows_at else 1.0
        self._clock.time_s = now + seconds if self._quota is None else self._quota.ends_at(now, seconds)

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        self._jobs.update((job.job_id, job) for job in jobs)
        goals_s = self._costs.slower * self._costs.goals_s * sum(bool(job.constraints) for job in jobs)
        self._take(self._costs.seconds(self._costs.prepare, len(jobs)) + goals_s)
        super().prepare(jobs)

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        self._take(self._costs.seconds(self._costs.step, len(job_ids)))
        self.steps += len(job_ids)
        return super().denoise(job_ids)

    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        self._take(self._costs.seconds(self._costs.decode, len(job_ids)))
        return super().decode(job_ids)

    def discard(self, job_ids: Sequence[int]) -> None:
        self.steps_thrown_away += sum(self._steps_done.get(job_id, 0) for job_id in job_ids)
        super().discard(job_ids)


class TimedRunner:
    """A runner that computes, while a virtual clock advances by what its calls cost on another machine."""

    def __init__(self, runner: Runner, clock: VirtualClock, costs: Costs) -> None:
        self._runner, self._clock, self._costs = runner, clock, costs

    @property
    def facts(self) -> ModelFacts:
        return self._runner.facts

    def num_passes(self, job: WindowJob) -> int:
        return self._runner.num_passes(job)

    def features(self, rows: Float32Array) -> Float32Array:
        return self._runner.features(rows)

    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array:
        return self._runner.outputs(names, rows)

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        self._clock.time_s += self._costs.seconds(self._costs.prepare, len(jobs))
        self._runner.prepare(jobs)

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        self._clock.time_s += self._costs.seconds(self._costs.step, len(job_ids))
        return self._runner.denoise(job_ids)

    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        self._clock.time_s += self._costs.seconds(self._costs.decode, len(job_ids))
        return self._runner.decode(job_ids)

    def discard(self, job_ids: Sequence[int]) -> None:
        self._runner.discard(job_ids)
