"""Simulate a crowd on a GPU without one: `python -m tests.bench.gpu_rehearsal --characters 1400 --slower 2`.

The engine is the real one. On a virtual clock, its calls take what they took on an H200 at the released size
(`docs/performance/gpu.md`), and its own CPU time is multiplied by `--slower`, since the CPU of a machine with a GPU may
be slower than this one. So the effect of a change of scheduling on edits shows within seconds, though not to the
millisecond: the engine's own time differs from run to run. Compare runs with and without a change made side by side.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.own_time import own_time_s
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.profile import profile
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.ops.memory import settled_objects
from tests.bench.contest import contest_config, null_embeddings
from tests.bench.costed_runner import CostedRunner, Costs, VirtualClock
from tests.bench.crowd import Habits
from tests.bench.offline import HISTORY_FRAMES
from tests.bench.trial import Contestant, Trial, run_trial

# Measured in a quiet minute; rows of a step have two evaluations each.
ON_AN_H200 = Costs(prepare=(0.0007, 0.00005), step=(0.00105, 0.000021), decode=(0.0011, 0.00005), goals_s=0.00025)
WARM_UP_S, MEASURED_S = 2.5, 5.0


class CountingClock(VirtualClock):
    """Time that passes with calls of the model and with this process's CPU time."""

    def __init__(self, slower: float) -> None:
        super().__init__()
        self._slower, self._begun_s = slower, time.process_time()

    def now(self) -> float:
        return self.time_s + self._slower * (time.process_time() - self._begun_s)

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


def rehearse(
    characters: int, slower: float, max_rows: int, config: EngineConfig | None = None, measured_s: float = MEASURED_S
) -> Trial:
    """A trial as in the engine's table. config: the engine's; None: without refusals and degradation."""
    clock = CountingClock(slower)
    runner, config = CostedRunner(clock, ON_AN_H200), config or contest_config(max_rows)
    costs = profile(runner, clock, max_rows, HISTORY_FRAMES).costs
    costs.begin_own(slower * own_time_s(runner.facts, config))  # as in an engine process
    one = Contestant("GPU", "in virtual time", runner, lambda: Scheduler(costs, max_rows, max_step_s=config.max_step_s))
    embeddings = null_embeddings(runner)
    with settled_objects():
        return run_trial(
            one,
            characters,
            Habits(),
            embeddings,
            config,
            warm_up_s=WARM_UP_S,
            measure_s=measured_s,
            clock=clock,
            lease=Device(counts_own=True).lease(),
        )


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.gpu_rehearsal", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--characters", type=int, nargs="+", default=[1400])
    parser.add_argument(
        "--slower", type=float, nargs="+", default=[1.5, 2.0, 3.0], help="factor on the engine's own CPU time"
    )
    parser.add_argument("--rows", type=int, default=128, help="most rows per step (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=MEASURED_S, help="how long to measure (default: %(default)s)")
    parser.add_argument(
        "--admission", action="store_true", help="refuse sessions, and degrade them, where a server would do so"
    )
    options = parser.parse_args()
    config = replace(EngineConfig(max_sessions=1 << 16), max_rows=options.rows) if options.admission else None
    print("| characters | own time | admitted | less | missed | windows/s | rows a step | edits p50 / p90 / p99 |")
    print("|---:|---:|---:|---:|---:|---:|---:|---:|")
    for characters in options.characters:
        for slower in options.slower:
            found = rehearse(characters, slower, options.rows, config, options.seconds)
            edits = " / ".join(f"{1000 * each:.0f}" for each in np.percentile(found.latencies_s or [0.0], [50, 90, 99]))
            of_steps = f"{found.windows_per_s:.0f} | {found.rows:.1f}"
            let_in = f"{characters - found.refused} | {found.less}"
            row = f"{let_in} | {found.missed:.2%} | {of_steps} | {edits} ms"
            print(f"| {characters} | {slower:g} times | {row} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
