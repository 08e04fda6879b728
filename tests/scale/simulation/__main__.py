"""`python -m tests.scale.simulation`: days of 10, 100 and 1,000 servers, as a table and a picture."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from tests.scale.simulation.assumptions import CPU_CAPACITY, ENGINE_CAPACITY, Assumptions
from tests.scale.simulation.day import Outcome, Simulation
from tests.scale.simulation.fleet import Placement

CLIENTS = {CPU_CAPACITY: 10.0, ENGINE_CAPACITY: 100.0}
"""Characters per client of such servers: the client is a player's game, or a game server with many players."""
HEAD = (
    "| servers | characters each | placed by | clients refused at first | waited, p99 | gave up "
    "| load of the fullest, p99 | moved | pose held for it, p99 / most | held of all | upgrade |"
)


def percentile(values: list[float], share: float) -> float:
    """The percentile; 0 without values."""
    return float(np.percentile(values, share)) if values else 0.0


def row(servers: int, capacity: int, placement: Placement, outcome: Outcome, day_begins_at: float) -> str:
    """One day as a row of the table."""
    fullest = [sample.most for sample in outcome.samples if sample.at >= day_begins_at]
    share = 100 * outcome.held / max(1.0, outcome.played)
    upgrade = f"{outcome.upgraded_s / 60:.0f} min" if outcome.upgraded_s else "not over"
    return (
        f"| {servers:,} | {capacity:,} | {placement.value} | {100 * outcome.refused / max(1, outcome.opened):.2f} % "
        f"| {percentile(outcome.waited, 99):.0f} s | {outcome.given_up} | {percentile(fullest, 99):.2f} "
        f"| {outcome.moved:,} | {percentile(outcome.away, 99):.1f} / {max(outcome.away, default=0.0):.1f} s "
        f"| {share:.4f} % | {upgrade} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.scale.simulation", description=__doc__)
    parser.add_argument("--servers", type=int, nargs="+", default=[10, 100, 1000])
    parser.add_argument("--capacities", type=int, nargs="+", default=list(CLIENTS), choices=list(CLIENTS))
    parser.add_argument(
        "--placed-by",
        nargs="+",
        type=Placement,
        default=list(Placement),
        help=", ".join(each.value for each in Placement),
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder for the picture (default: do not draw one)")
    options = parser.parse_args()
    begun = time.process_time()
    print(HEAD)
    print("|---:|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    shown = {}
    for capacity in options.capacities:
        for servers in options.servers:
            given = Assumptions(capacity, characters=CLIENTS[capacity])
            for placement in options.placed_by:
                simulation = Simulation(servers, placement, given, seed=options.seed)
                outcome = simulation.run()
                print(row(servers, capacity, placement, outcome, simulation.day.warm_until), flush=True)
                shown[servers, capacity, placement] = outcome
    print(f"\nseed {options.seed}, {time.process_time() - begun:.0f} s of CPU time")
    if options.out:
        from tests.scale.simulation.picture import draw_days

        print(draw_days(shown, options.out))


if __name__ == "__main__":
    main()
