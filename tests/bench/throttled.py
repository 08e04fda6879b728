"""Does admission admit as many as a CPU quota can serve? `python -m tests.bench.throttled --cores 0.7 1 1.5`.

A server with its engines runs under a quota of CPU time (`tests.bench.cpu_quota`); the load is not limited. First, the
most characters that the server serves in full if it refuses none; then, with default settings, how many of a multiple
of them are admitted, and what they get. Both arrive over the same time, as a rush leaves a backlog of windows due to
which sessions miss frames long after. In full means under 1 % of frames missed and no session degraded; with
`--undegraded` the search runs without degradation, and only missed frames count. `tests.bench.admission` does the same
in virtual time.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from motiongen_tools.bench.bracket import Bracket
from motiongen_tools.bench.load import Load
from motiongen_tools.bench.recorder import EVENT
from motiongen_tools.bench.result import Result, Standard
from motiongen_tools.bench.run import run_load
from motiongen_tools.bench.scenario import BUILT_IN, load_scenario
from motiongen_tools.server_process import ServerProcess
from tests.bench.counting import most_passing
from tests.bench.cpu_quota import CpuQuota
from tests.bench.machine import busy_share, machine_facts
from tests.bench.served import Most
from tests.server_process import over

_FREE, _UNDEGRADED = ("--admit-load", "1000"), ("--degrade", "false")
_BOTH = ("--log-level", "ERROR", "--max-sessions", "4096", "--events-per-second", "1000")
_CHARACTERS_A_CORE = 60  # with which the search begins
_REST_S = 3.0
_REFUSED, _LEVEL, _FULL = "refused open", "service level: ", "service level: FULL"
HEADER = (
    "| scenario | cores | engines | could be served | asked | admitted | of it | degraded | missed by them "
    "| edits, ms | cores used | others' | void |",
    "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|",
)


@dataclass(frozen=True)
class Machine:
    """A CPU quota, and how many engines share it. settings: further settings of the server."""

    cores: float
    engines: int
    settings: tuple[str, ...]
    shares: int = 1024

    @contextmanager
    def server(self, *settings: str) -> Iterator[ServerProcess]:
        """A server that is ready, and under the quota since its start."""
        ordinary = ("--devices", f"cpu:{self.engines}", *_BOTH)
        process = ServerProcess(over(ordinary, (*self.settings, *settings)))
        with CpuQuota(self.cores, self.shares) as quota:
            with quota.joined():
                process.start()
            try:
                yield process
            finally:
                process.stop()


@dataclass(frozen=True)
class Effort:
    """scenario: its name. seconds: of each run. times: the multiple of the servable number that asks within ramp_s.

    program: a motiongen-load that plays instead of Python, which takes half a core for a hundred characters.
    undegraded: degradation is off in the search, so that only missed frames count.
    """

    scenario: str
    seconds: int
    seed: int
    times: float
    ramp_s: float
    max_lag_ms: float
    program: Path | None = None
    undegraded: bool = False


async def play(server: ServerProcess, characters: int, effort: Effort) -> Result:
    scenario = replace(load_scenario(effort.scenario), ramp_s=effort.ramp_s)
    load = Load(server.address, scenario, characters, effort.seconds, effort.seed, program=effort.program)
    result = await run_load(load, lambda _: None, Standard(max_lag_ms=effort.max_lag_ms), server.pid)
    missed, use = result.figures().miss_ratio, result.server_use
    used = "" if use is None else f", {use.cores:.2f} cores"
    less = f"{times_told_of_less(result)} times degraded"
    print(f"  {characters} asked: {missed:.2%} missed, {less}{used} {result.void_reasons() or ''}", file=sys.stderr)
    return result


def times_told_of_less(result: Result) -> int:
    """How often sessions were told of a service level below FULL."""
    told = dict(result.counts()).items()
    return sum(count for name, count in told if name.startswith(_LEVEL) and not name.startswith(_FULL))


async def most_servable(machine: Machine, effort: Effort, guess: int) -> Most:
    """The most characters that are served in full when all are admitted."""

    def passes(result: Result) -> bool:
        return result.figures().miss_ratio < Standard.max_miss_ratio and not times_told_of_less(result)

    with machine.server(*_FREE, *(_UNDEGRADED if effort.undegraded else ())) as server:

        async def trial(characters: int) -> Result:
            result = await play(server, characters, effort)
            await asyncio.sleep(_REST_S)
            return result

        return Most(*await most_passing(Bracket(guess), trial, passes))


def row(machine: Machine, effort: Effort, could: Most, result: Result, others: float) -> str:
    """The row of one machine. could: the number that could be served."""
    counts, asked = dict(result.counts()), result.load.characters
    refused = sum(count for name, count in counts.items() if name.startswith(_REFUSED))
    edits, use = result.latency_ms(EVENT), result.server_use
    less, missed = times_told_of_less(result), result.figures().miss_ratio
    cells = [
        effort.scenario, f"{machine.cores:g}", f"{machine.engines}", f"{could}", f"{asked}", f"{asked - refused}",
        f"{(asked - refused) / max(could.characters, 1):.0%}", f"{less}", f"{missed:.2%}",
        f"{edits['p50']:.0f} / {edits['p99']:.0f}" if edits["count"] else "-",
        "-" if use is None else f"{use.cores:.2f}", f"{others:.0%}", "void" if result.void_reasons() else "no",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


async def measure(machine: Machine, effort: Effort, could: int | None) -> str:
    others = busy_share()
    if could is None:
        most = await most_servable(machine, effort, max(4, round(_CHARACTERS_A_CORE * machine.cores)))
    else:
        most = Most(could, or_more=False)
    with machine.server() as server:
        result = await play(server, max(1, round(effort.times * most.characters)), effort)
    return row(machine, effort, most, result, others())


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.throttled", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("server", nargs="*", metavar="-- SETTING", help="for the servers")
    parser.add_argument("--cores", type=float, nargs="+", default=[0.7, 1.0, 1.5], help="quotas (default: 0.7 1 1.5)")
    parser.add_argument("--engines", type=int, nargs="+", default=[1, 2], help="for each quota (default: 1 2)")
    parser.add_argument("--scenario", nargs="+", default=["crowd"], choices=BUILT_IN)
    parser.add_argument("--seconds", type=int, default=10, help="duration of each run (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--times", type=float, default=2.0, help="multiple of the servable number that asks (default: %(default)g)"
    )
    parser.add_argument("--ramp-s", type=float, default=20.0, help="time in which all arrive (default: %(default)g)")
    parser.add_argument("--could", type=int, help="the number that could be served, if known: skips the search")
    parser.add_argument("--undegraded", action="store_true", help="search without degradation")
    parser.add_argument("--max-lag-ms", type=float, default=5.0, help="a later load is void (default: %(default)g)")
    parser.add_argument("--program", type=Path, metavar="PATH", help="of motiongen-load, to play instead of Python")
    parser.add_argument("--shares", type=int, default=1024, help="weight of the quota's group against others")
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    for line in HEADER:
        print(line, flush=True)
    for name in options.scenario:
        effort = Effort(
            name, options.seconds, options.seed, options.times, options.ramp_s, options.max_lag_ms, options.program,
            options.undegraded,
        )  # fmt: skip
        for cores in options.cores:
            for engines in options.engines:
                machine = Machine(cores, engines, tuple(options.server), options.shares)
                print(asyncio.run(measure(machine, effort, options.could)), flush=True)
    print()
    for key, value in {**machine_facts(), "command": " ".join(sys.argv[1:])}.items():
        print(f"- {key}: {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
