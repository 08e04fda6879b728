"""A million engine steps in virtual time: `python -m tests.bench.simulate [--ticks N] [--seed S] [--seconds S]`.

Simulates days whose crowds, costs, failures and losses are drawn from a seed. Every step of the scheduler and all that
a client sees is checked: no job lost or done twice, order within a class, no class starved, no frame beyond the credit,
nothing from an old session or plan, every edit answered once. If a day breaks a rule, prints its seed and exits with
code 1.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections import Counter

from motiongen_server.engine.types import Priority
from tests.server.engine.day import Day

TICKS_A_DAY = 10_000
HAPPENINGS = (
    "windows", "frames_sent", "frames_superseded", "windows_discarded", "windows_restarted", "nan_rows",
    "runner_faults", "memory_splits", "deadline_misses", "frames_held", "opens", "closes",
)  # fmt: skip


def simulate(ticks: int, first_seed: int, limit_s: float) -> tuple[int, Counter[str], dict[Priority, int]]:
    """Simulate days until there are so many ticks, or limit_s has passed.

    Returns the ticks, how often each thing happened, and the longest wait of each class in rows. Raises what a day
    raises.
    """
    happened: Counter[str] = Counter()
    longest = dict.fromkeys(Priority, 0)
    done = 0
    began = time.monotonic()
    for seed in range(first_seed, first_seed + -(-ticks // TICKS_A_DAY)):
        day = Day(seed)
        try:
            day.live(TICKS_A_DAY)
            day.end()
        except BaseException:
            print(f"the day of seed {seed} broke a rule at step {len(day.stage.reports)}", file=sys.stderr)
            raise
        done += len(day.stage.reports)
        for what in HAPPENINGS:
            happened[what] += day.stage.total(what)
        for priority, rows in day.scheduler.longest_wait.items():
            longest[priority] = max(longest[priority], rows)
        if time.monotonic() - began > limit_s:
            break
    return done, happened, longest


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.simulate", description=__doc__)
    parser.add_argument("--ticks", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1, help="of the first day; each further day has the next one")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no more days after so many")
    settings = parser.parse_args()
    logging.disable(logging.CRITICAL)
    done, happened, longest = simulate(settings.ticks, settings.seed, settings.seconds)
    print(f"{done} steps of the engine, no rule broken")
    for what in HAPPENINGS:
        print(f"{what:>20} {happened[what]}")
    for priority, rows in longest.items():
        print(f"{priority.name:>20} waited at most {rows} rows")
    return 0


if __name__ == "__main__":
    sys.exit(main())
