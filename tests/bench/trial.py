"""A trial: so many characters, in real time, with one runner and one policy; and the search for the most characters."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.ports import Runner
from motiongen_server.engine.scheduling.device import DeviceLease
from motiongen_server.engine.scheduling.policy import SchedulingPolicy
from motiongen_server.engine.types import Float32Array
from motiongen_tools.bench.bracket import Bracket
from tests.bench.clocks import BenchClock
from tests.bench.crowd import Crowd, Habits
from tests.bench.machine import busy_share

MISS_LIMIT = 0.01
MOST_BY_OTHERS = 0.1


@dataclass(frozen=True)
class Contestant:
    """An engine to measure. make_policy: makes a new policy for each trial, which keeps what the last one learned."""

    name: str
    meaning: str
    runner: Runner
    make_policy: Callable[[], SchedulingPolicy]


@dataclass(frozen=True)
class Trial:
    """A trial's results. missed: the share of frame times without a frame, of the characters that were admitted.

    rows: mean rows per step. latencies_s: of edits scheduled before the end of the measured part. refused: characters
    refused. less: how often a session was degraded. others_share: of the machine, used by other processes.
    """

    characters: int
    missed: float
    windows_per_s: float
    discarded: int
    rows: float
    idle: float
    latencies_s: tuple[float, ...]
    broken: int
    refused: int
    less: int
    others_share: float

    @property
    def passed(self) -> bool:
        return self.missed < MISS_LIMIT and not self.refused

    @property
    def disturbed(self) -> bool:
        """Whether it failed while other processes used the machine, so that it says little."""
        return not self.passed and self.others_share > MOST_BY_OTHERS


@dataclass(frozen=True)
class Effort:
    """Seconds of a trial before and during measurement; the most trials of a search, after the first two."""

    warm_up_s: float = 5.0
    measure_s: float = 5.0
    latency_s: float = 15.0
    num_trials: int = 5
    offline_s: float = 1.5
    profile_s: float = 3.0
    product_s: float = 0.4

    def lasting(self, seconds: float) -> Effort:
        """A copy with trials of so many seconds."""
        return replace(self, warm_up_s=seconds, measure_s=seconds, latency_s=max(seconds, self.latency_s))


QUICK = Effort(warm_up_s=2.5, measure_s=2.5, latency_s=5.0, num_trials=2, offline_s=0.7, profile_s=1.5)


def run_trial(
    contestant: Contestant,
    characters: int,
    habits: Habits,
    embeddings: Sequence[Float32Array],
    config: EngineConfig,
    *,
    warm_up_s: float,
    measure_s: float,
    clock: BenchClock,
    lease: DeviceLease | None = None,
) -> Trial:
    """Open all characters within half a second, let them settle, and from then on count what each misses.

    lease: the engine's lease of its device, if not an ordinary one.
    """
    facts = contestant.runner.facts
    gc.collect()
    crowd = Crowd(characters, habits, embeddings, facts.model_id, facts.fps, clock)
    policy = contestant.make_policy()
    engine = Engine(contestant.runner, clock, crowd.deliver, config, inbox=crowd, scheduler=policy, lease=lease)
    begin = clock.now() + warm_up_s
    end = begin + measure_s
    windows = discarded = steps = rows = 0
    idle_s = 0.0
    share = busy_share()
    while (now := clock.now()) < end:
        report = engine.step()
        if now >= begin:
            windows, discarded = windows + len(report.windows), discarded + report.windows_discarded
            steps, rows = steps + bool(report.rows), rows + report.rows
        if not report.rows:
            slept_at = clock.now()
            crowd.wait(min(engine.idle_s(), end - slept_at))
            idle_s += (clock.now() - slept_at) * (now >= begin)
    ended_at = clock.now()
    others_share = share()
    measured_s = ended_at - begin
    served = [playback for playback in crowd.playbacks if playback.let_in]
    held_s = sum(playback.held_between(begin, ended_at) for playback in served)
    crowd.leave()
    engine.step()
    return Trial(
        characters,
        held_s / (measured_s * max(1, len(served))),
        windows / measured_s,
        discarded,
        rows / max(1, steps),
        idle_s / measured_s,
        tuple(latency for playback in crowd.playbacks for latency in playback.latencies_s),
        sum(playback.broken for playback in crowd.playbacks),
        crowd.num_refused_opens,
        crowd.num_told_of_less,
        others_share,
    )


def most_characters(passes: Callable[[int], bool], guess: int, num_trials: int) -> int:
    """The largest number found to pass, starting from a guess; 0 if not even one character passes.

    num_trials: the most trials, counted from the first that passes.
    """
    bracket = Bracket(max(1, guess), tolerance=1 / 16)
    while num_trials > 0 and (number := bracket.next()) is not None:
        bracket.note(number, passes(number))
        num_trials -= bool(bracket.most)
    return bracket.most
