"""The engines that are compared, from the simplest to the one that serves, and their trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

from motiongen_ardy.model.model import Model
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.ports import Runner
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.policy import SchedulingPolicy
from motiongen_server.engine.scheduling.profile import profile
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.types import Float32Array
from motiongen_server.runner import TorchRunner
from tests.bench.clocks import BenchClock, ProcessorClock
from tests.bench.crowd import Habits
from tests.bench.null_runner import NullRunner
from tests.bench.offline import HISTORY_FRAMES, offline_rate
from tests.bench.plain_runner import PlainRunner, RolloutRunner, job_shape
from tests.bench.policies import OneAtATime, StepsInOrder, WholeWindows
from tests.bench.trial import Contestant, Effort, Trial, most_characters, run_trial

NAMES = ("B0", "B1", "B2", "B3", "B4", "B5", "null")
PLAIN_ROWS = 32  # per step, for the engines without speed-ups: more rows only make their steps longer
LATENCY_LOAD = 0.7
WINDOWS_A_SECOND = 0.5  # of a character without edits: 40 frames every two seconds
MOST_NULL_CHARACTERS = 4000
MOST_REPEATS = 2  # of a trial that other processes disturbed


@dataclass(frozen=True)
class Standing:
    """What one contestant reached. characters: the most with under 1 % misses. trials: of the search, in order.

    offline_windows_per_s: its runner's, with the fullest batches it makes. at_load: the trial with 70 % of the
    characters, for the latencies.
    """

    name: str
    meaning: str
    characters: int
    offline_windows_per_s: float
    trials: tuple[Trial, ...]
    at_load: Trial | None

    def latency_ms(self, percentile: float) -> float | None:
        """From an edit to the first changed frame, at 70 % load."""
        if self.at_load is None or not self.at_load.latencies_s:
            return None
        return 1000 * float(np.percentile(self.at_load.latencies_s, percentile))

    @property
    def best(self) -> Trial | None:
        """The largest trial that passed."""
        return max((trial for trial in self.trials if trial.passed), key=lambda trial: trial.characters, default=None)


@dataclass(frozen=True)
class Contest:
    """What all contestants share. runner, bf16_runner: the runners that serve, with all their speed-ups.

    bf16: whether the baselines and `runner` multiply in bfloat16 too.
    """

    model: Model
    embeddings: Sequence[Float32Array]
    runner: Runner
    bf16_runner: Runner
    habits: Habits
    config: EngineConfig
    effort: Effort
    clock: BenchClock
    bf16: bool = False

    def contestant(self, name: str) -> Contestant:
        """One of NAMES. The cost of its calls has been measured, as a server does before it is ready."""
        rows, model = self.config.max_rows, self.model
        plain_rows = min(rows, PLAIN_ROWS)

        def plain() -> Runner:
            return PlainRunner(model, "plain", bf16=self.bf16)

        match name:
            case "B0":
                runner: Runner = RolloutRunner(model, "rollout", bf16=self.bf16)
                return self._made(name, "one window at a time, motiongen_ardy.model.rollout", runner, 1, OneAtATime)
            case "B1":
                meaning = "whole windows of one shape, gathered for 20 ms"
                return self._made(
                    name, meaning, plain(), plain_rows,
                    lambda costs: WholeWindows(costs, plain_rows, lambda job: (job_shape(model, job), job.num_steps)),
                )  # fmt: skip
            case "B2":
                meaning = "steps batched, first in first out"
                return self._made(name, meaning, plain(), plain_rows, lambda costs: StepsInOrder(costs, plain_rows))
            case "B3":
                return self._made(name, "B2 with classes and deadlines", plain(), rows, self._scheduler)
            case "B4":
                return self._made(name, "B3 with all speed-ups: as served", self.runner, rows, self._scheduler)
            case "B5":
                return self._made(name, "B4 in bfloat16: --precision auto", self.bf16_runner, rows, self._scheduler)
            case _:
                return self._made(name, "B4's engine, no model", NullRunner(), rows, self._scheduler)

    def _scheduler(self, costs: CostTable) -> SchedulingPolicy:
        return Scheduler(costs, self.config.max_rows, max_step_s=self.config.max_step_s)

    def _made(
        self, name: str, meaning: str, runner: Runner, rows: int, policy: Callable[[CostTable], SchedulingPolicy]
    ) -> Contestant:
        with runner.recording_at_once() if isinstance(runner, TorchRunner) else nullcontext():
            costs = profile(runner, self.clock, rows, HISTORY_FRAMES, self.effort.profile_s).costs
        return Contestant(name, meaning, runner, lambda: policy(costs))

    def measure(self, name: str, say: Callable[[str], None]) -> Standing:
        """Search for the most characters, then measure latencies below that."""
        say(f"{name}: profile")
        one = self.contestant(name)
        embeddings = self.embeddings if name != "null" else null_embeddings(one.runner)
        size = 1 if name == "B0" else self.config.max_rows
        offline_s = self.effort.offline_s
        offline = offline_rate(
            one.runner, size, self.habits.num_steps, embeddings, seconds=offline_s, clock=self.clock
        ).windows_per_s
        trials: list[Trial] = []

        def trial(characters: int, measure_s: float) -> Trial:
            say(f"{name}: {characters} characters")
            warm_up_s = self.effort.warm_up_s
            tried = run_trial(
                one,
                characters,
                self.habits,
                embeddings,
                self.config,
                warm_up_s=warm_up_s,
                measure_s=measure_s,
                clock=self.clock,
            )
            say(f"  {tried.missed:.1%} missed, {tried.windows_per_s:.1f} windows/s, others {tried.others_share:.0%}")
            return tried

        def passes(characters: int) -> bool:
            for _ in range(MOST_REPEATS):
                trials.append(trial(characters, self.effort.measure_s))
                if not trials[-1].disturbed or isinstance(self.clock, ProcessorClock):
                    break
            return trials[-1].passed

        guess = min(MOST_NULL_CHARACTERS, int(0.7 * offline / (WINDOWS_A_SECOND + self.habits.edits_hz)))
        most = most_characters(passes, guess, self.effort.num_trials)
        at_load = trial(max(1, int(LATENCY_LOAD * most)), self.effort.latency_s) if most else None
        return Standing(name, one.meaning, most, offline, tuple(trials), at_load)


def null_embeddings(runner: Runner) -> list[Float32Array]:
    return [np.full(runner.facts.embedding_dim, value, np.float32) for value in range(1, 6)]


def contest_config(max_rows: int) -> EngineConfig:
    """The engine as served, but without refusals and degradation, since the most it can do is sought."""
    return replace(
        EngineConfig(),
        max_rows=max_rows,
        max_sessions=2 * MOST_NULL_CHARACTERS,
        admit_load=(1e6, 1e6, 1e6, 1e6),
        degrade=False,
        guard_drift=False,  # random weights do not make plausible motion
    )
