"""How soon full service returns after overload: `python -m tests.bench.recovery [--times 2 5] [--seconds 20]`.

In virtual time, with an engine that refuses none: so many times the CROWD sessions that it could serve in full, and one
HERO. When only half of what fits is left, this measures how long those are still served at a lower tier, and how
the tier moved.
"""

from __future__ import annotations

import argparse
import itertools
import logging
import sys
from dataclasses import dataclass

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Priority, ServiceTier
from tests.server.engine.stage import Stage
from tests.server.engine.viewer import Viewer

STEP_S = 0.05
ROWS = 4
FITS = 40
"""Sessions that such a machine can just serve: half a window per second each, of four steps, in batches of ROWS."""
LIMIT_S = 600.0
AGAIN_S = 0.25
SPAN_S = 5.0


@dataclass(frozen=True)
class Recovery:
    """times: the load, as a multiple of what fits. lowest: the lowest tier.

    recovered_s: from the end of the overload until all are at FULL; None: never. turns: how often the crowd's tier
    changed direction. fastest: the most changes of the tier within SPAN_S. hero_underruns: over the whole run.
    """

    times: float
    lowest: ServiceTier
    recovered_s: float | None
    turns: int
    fastest: int
    hero_underruns: int


def _turns(tiers: list[ServiceTier]) -> int:
    """How often a sequence of tiers changes direction."""
    ways = [later > earlier for earlier, later in itertools.pairwise(tiers) if later != earlier]
    return sum(later != earlier for earlier, later in itertools.pairwise(ways))


def recover(times: float, seconds: float) -> Recovery:
    """Run an overload for so long, then half of what fits."""
    stage = Stage(EngineConfig(max_rows=ROWS, max_sessions=4096, admit_load=(99.0, 99.0, 99.0, 99.0)))
    stage.runner.step_s = lambda rows: STEP_S
    stage.runner.holds = True
    hero = stage.open(1, priority=Priority.HERO)
    crowd: list[Viewer] = [stage.open(2 + n, priority=Priority.CROWD) for n in range(round(times * FITS))]
    course: list[tuple[float, ServiceTier]] = [(0.0, ServiceTier.FULL)]

    def go_on() -> bool:
        """Continue for a while. Returns whether all are served in full now."""
        stage.run(AGAIN_S)
        tier = stage.tiers().get(Priority.CROWD, ServiceTier.FULL)
        if tier is not course[-1][1]:
            course.append((stage.clock.now(), tier))
        return all(stage.tiers().get(each) is ServiceTier.FULL for each in (Priority.HERO, Priority.CROWD))

    too_much_until = stage.clock.now() + seconds
    while stage.clock.now() < too_much_until:
        go_on()
    for viewer in crowd[FITS // 2 :]:
        if viewer.closed is None:
            stage.close(viewer)
    gone_at, recovered_s = stage.clock.now(), None
    while recovered_s is None and stage.clock.now() < gone_at + LIMIT_S:
        if go_on():
            recovered_s = stage.clock.now() - gone_at
    moments = [at_s for at_s, _ in course[1:]]
    fastest = max((sum(begin <= at_s < begin + SPAN_S for at_s in moments) for begin in moments), default=0)
    tiers = [tier for _, tier in course]
    return Recovery(times, max(tiers), recovered_s, _turns(tiers), fastest, hero.underruns)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.recovery", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--times", type=float, nargs="+", default=[2.0, 5.0], help="of what can be served in full")
    parser.add_argument("--seconds", type=float, nargs="+", default=[20.0, 60.0], help="durations of the overload")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    print(
        "| load | for | lowest tier | in full again after | turns of the tier | moves in 5 s | the HERO's underruns |"
    )
    print("|---:|---:|---|---:|---:|---:|---:|")
    for times in options.times:
        for seconds in options.seconds:
            found = recover(times, seconds)
            again = "never" if found.recovered_s is None else f"{found.recovered_s:.0f} s"
            print(
                f"| {times:g} times | {seconds:g} s | {found.lowest.name} | {again} | {found.turns} | {found.fastest} "
                f"| {found.hero_underruns} |",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
