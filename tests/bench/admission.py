"""Does admission admit as many as can be served? `python -m tests.bench.admission [--scenario crowd] [--cores 0.7 1]`.

In virtual time, like `tests.bench.rehearsal`: first the largest number of characters that can be served with under 1 %
of frames missed when none is refused or degraded; then how many of twice as many (`--times`) are admitted, and what
they get. A fractional number of cores is modelled as whole cores whose calls take longer, which is a quota's effect on
average; with --quota, as a quota that is used up and renewed every 100 ms.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
from dataclasses import dataclass, replace

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine_process.model_loading import admit_loads
from motiongen_tools.bench.scenario import BUILT_IN, Scenario, load_scenario
from tests.bench.costed_runner import Costs
from tests.bench.rehearsal import Rehearsal, rehearse

FULL_MISS = 0.01
_FREE = EngineConfig(max_sessions=1 << 16, admit_load=(1e6, 1e6, 1e6, 1e6), degrade=False)
_SERVED = EngineConfig(max_sessions=1 << 16)
_PRECISION = 0.03  # of the search


@dataclass(frozen=True)
class Machine:
    """cores: how many there are; 1.5 is two of 0.75 each. quota: the cores are given as a `VirtualQuota`."""

    cores: float
    seed: int = 1
    quota: bool = False
    engines: int | None = None

    def play(self, scenario: Scenario, characters: int, seconds: int, config: EngineConfig) -> Rehearsal:
        engines = self.engines or math.ceil(self.cores)
        if self.quota:
            return rehearse(
                scenario,
                characters,
                seconds,
                self.seed,
                costs=Costs(),
                engines=engines,
                config=config,
                quota=self.cores,
            )
        return rehearse(
            scenario,
            characters,
            seconds,
            self.seed,
            costs=Costs(slower=engines / self.cores),
            engines=engines,
            config=config,
        )


def missed(found: Rehearsal) -> float:
    """The share of frames missed by the characters that were admitted."""
    return sum(seen.missed_s for seen in found.outcomes.values()) / max(sum(found.frames_s.values()), 1e-9)


def most_servable(machine: Machine, scenario: Scenario, seconds: int) -> int:
    """The most characters with under 1 % of frames missed, when all are admitted and none is degraded."""
    low, high = 0, 8
    while missed(machine.play(scenario, high, seconds, _FREE)) < FULL_MISS:
        low, high = high, 2 * high
    while high - low > max(1, _PRECISION * low):
        middle = (low + high) // 2
        is_served = missed(machine.play(scenario, middle, seconds, _FREE)) < FULL_MISS
        low, high = (middle, high) if is_served else (low, middle)
    return low


def let_in(
    machine: Machine, scenario: Scenario, asked: int, seconds: int, load: float | None = None
) -> tuple[int, int, Rehearsal]:
    """How many are admitted, how often one was degraded, and all results. load: the setting admit_load."""
    config = _SERVED if load is None else replace(_SERVED, admit_load=admit_loads(load))
    found = machine.play(scenario, asked, seconds, config)
    refused = sum(seen.refused for seen in found.outcomes.values())
    return asked - refused, sum(seen.degraded for seen in found.outcomes.values()), found


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.admission", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--scenario", nargs="+", default=["crowd"], choices=BUILT_IN)
    parser.add_argument("--cores", type=float, nargs="+", default=[0.7, 1.0, 1.5, 2.0])
    parser.add_argument("--times", type=float, nargs="+", default=[2.0], help="multiples of what can be served")
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quota", action="store_true", help="model the cores as a CPU quota, renewed every 100 ms")
    parser.add_argument("--engines", type=int, help="number of engines (default: one for each core)")
    parser.add_argument("--admit-load", type=float, help="the server's setting (default: the engine's own)")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    print("| scenario | cores | could be served | asked | admitted | of it | degraded | missed by them |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name in options.scenario:
        for cores in options.cores:
            machine, scenario = Machine(cores, options.seed, options.quota, options.engines), load_scenario(name)
            could = most_servable(machine, scenario, options.seconds)
            for times in options.times:
                asked = round(times * could)
                count, degraded, found = let_in(machine, scenario, asked, options.seconds, options.admit_load)
                share = count / max(could, 1)
                figures = f"{could} | {asked} | {count} | {share:.0%} | {degraded} | {missed(found):.2%}"
                print(f"| {name} | {cores:g} | {figures} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
