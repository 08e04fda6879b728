"""How soon streams get answers: `python -m tests.bench.pings --program PATH [--streams 1000] [--before COMMIT]`.

The real gateway and engine with a model that computes nothing, and many streams of one character each, which play in
real time and edit as the crowd does. Each stream pings every two seconds, and the time to the pong is measured; there
is no model that takes CPU time. The load is motiongen-load, as `tests.cpp.building` builds it. Revisions alternate, and
so do rates of playhead reports (--report-hz).
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from motiongen_tools.bench.load import Load
from motiongen_tools.bench.recorder import EVENT, GENERATOR, ROUND_TRIP, SEND_LAG, STREAMS
from motiongen_tools.bench.result import Result, Standard
from motiongen_tools.bench.run import run_load
from motiongen_tools.bench.scenario import load_scenario
from tests.bench.machine import busy_share, machine_facts
from tests.bench.null_process import NULL_SERVER, SETTINGS, server_process
from tests.bench.revision import Revision, commit_tree
from tests.bench.service_cost import FLUSH_MS
from tests.bench.service_turns import TREE
from tests.server_process import over

HEADER = (
    "| revision | streams | ping p50 / p99 / max, ms | edits p50 / p99, ms | the load's lag p99, ms | server's cores "
    "| load's cores | void |",
    "|---|---:|---:|---:|---:|---:|---:|---|",
)


def play(revision: Revision, report_hz: float, options: argparse.Namespace) -> Result:
    """One run with its own server. report_hz: playhead reports of each stream."""
    arguments = over(SETTINGS, ("--flush-ms", str(FLUSH_MS), "--peer-streams", "4000", *options.server))
    with server_process(NULL_SERVER, *arguments, revision=revision) as server:
        scenario = replace(load_scenario("crowd"), characters_per_stream=1, report_hz=report_hz)
        load = Load(
            server.address, scenario, options.streams, options.seconds, options.seed, program=options.program.resolve()
        )
        return asyncio.run(run_load(load, lambda _: None, Standard(), server.pid))


def row(name: str, result: Result) -> str:
    pings, edits = result.latency_ms(ROUND_TRIP, STREAMS), result.latency_ms(EVENT)
    lag, use = result.latency_ms(SEND_LAG, GENERATOR), result.server_use
    cells = [
        name, f"{result.streams}", " / ".join(f"{pings[each]:.1f}" for each in ("p50", "p99", "max")),
        f"{edits['p50']:.0f} / {edits['p99']:.0f}", f"{lag['p99']:.1f}", "-" if use is None else f"{use.cores:.2f}",
        f"{sum(result.generator_cores):.2f}", "void" if result.void_reasons() else "no",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.pings", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("server", nargs="*", metavar="-- SETTING", help="for the servers")
    parser.add_argument("--program", type=Path, required=True, metavar="PATH", help="of motiongen-load")
    parser.add_argument("--before", nargs="*", default=[], metavar="COMMIT", help="also measure these, alternating")
    parser.add_argument("--streams", type=int, default=1000, help="with one character each (default: %(default)s)")
    parser.add_argument("--seconds", type=int, default=10, help="duration of each run (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=2, help="runs of each revision (default: %(default)s)")
    parser.add_argument("--report-hz", type=float, nargs="+", default=[load_scenario("crowd").report_hz], metavar="HZ")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def main() -> int:
    options, share = parse(), busy_share()
    for line in HEADER:
        print(line, flush=True)
    with ExitStack() as stack:
        revisions = [stack.enter_context(commit_tree(commit)) for commit in options.before]
        for _ in range(options.rounds):
            for revision in (*revisions, TREE):
                for hz in options.report_hz:
                    print(row(f"{revision.name}, {hz:g} Hz", play(revision, hz, options)), flush=True)
    facts = machine_facts() | {"others used": f"{share():.0%} of the machine", "command": " ".join(sys.argv[1:])}
    print("", *(f"- {name}: {value}" for name, value in facts.items()), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
