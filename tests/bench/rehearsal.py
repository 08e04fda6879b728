"""A scenario of `motiongen bench` in virtual time: `python -m tests.bench.rehearsal --scenario mixed --characters 80`.

The engines are the real ones, run one after another, each with its share of the characters. The model computes nothing:
it only advances the engine's clock by what `Costs` says that calls take. So the effect of a change of scheduling shows
in a few seconds, reproducibly, whatever else the machine does. Gateway, gRPC and client are not included.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.profile import profile
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.types import Priority
from motiongen_tools.bench.scenario import Scenario, load_scenario
from motiongen_tools.bench.schedule import make_schedule
from tests.bench.costed_runner import CostedRunner, Costs, VirtualClock, VirtualQuota
from tests.bench.scenario_script import Outcomes, Script

_OPENED_S = 1.0  # from so long after its open on, a character without frames counts as missing them


@dataclass
class Rehearsal:
    """The results of all engines together, for the characters that were admitted.

    waste: the share of denoising steps whose results were discarded.
    """

    outcomes: dict[Priority, Outcomes]
    frames_s: dict[Priority, float]
    waste: float
    rows: float
    busy: float
    restarted: int
    windows: int


def rehearse(
    scenario: Scenario,
    characters: int,
    seconds: int,
    seed: int,
    *,
    costs: Costs,
    engines: int,
    config: EngineConfig,
    quota: float | None = None,
) -> Rehearsal:
    """Play a scenario on so many engines; frames count in its measured part. quota: of cores, for all engines."""
    schedule = make_schedule(scenario, characters, seconds, seed)
    parts, runners = [], []
    steps = rows = restarted = windows = 0
    busy_s = total_s = 0.0
    begin, end = schedule.phases.measure_from_s, schedule.phases.end_s
    for index in range(engines):
        clock = VirtualClock()
        table = profile(CostedRunner(clock, costs), clock, 64, 16, 60.0).costs
        share = None if quota is None else VirtualQuota(min(1.0, quota / engines))
        runner = CostedRunner(clock, costs, share)
        device = Device(None if share is None else share.account)
        numbers = [plan.number for plan in schedule.characters if plan.number % engines == index]
        script = Script(scenario, schedule, numbers, clock)
        scheduler = Scheduler(table, 64, max_step_s=config.max_step_s)
        engine = Engine(runner, clock, script.deliver, config, inbox=script, scheduler=scheduler, lease=device.lease())
        while clock.now() < script.began_at + end:
            before = clock.now()
            report = engine.step()
            restarted, windows = restarted + report.windows_restarted, windows + len(report.windows)
            if report.rows:
                steps, rows, busy_s = steps + 1, rows + report.rows, busy_s + clock.now() - before
            else:
                script.wait(min(engine.idle_s(), 0.05))
        total_s += end
        parts.append(script)
        runners.append(runner)
    outcomes = {priority: Outcomes() for priority in Priority}
    frames_s = dict.fromkeys(Priority, 0.0)
    for part in parts:
        for number, playback in part.playbacks.items():
            mine, priority = outcomes[part.priority(number)], part.priority(number)
            mine.latencies_s += playback.latencies_s
            plan = schedule.characters[number]
            if number in part.refused:  # it is not shown
                continue
            shown = max(begin, plan.open_s + _OPENED_S), min(end, plan.close_s)
            if shown[0] < shown[1]:
                mine.missed_s += playback.held_between(part.began_at + shown[0], part.began_at + shown[1])
                frames_s[priority] += shown[1] - shown[0]
        for priority, found in part.outcomes.items():
            outcomes[priority].opens_s += found.opens_s
            outcomes[priority].refused += found.refused
            outcomes[priority].degraded += found.degraded
    waste = sum(runner.steps_thrown_away for runner in runners) / max(1, sum(runner.steps for runner in runners))
    return Rehearsal(outcomes, frames_s, waste, rows / max(1, steps), busy_s / total_s, restarted, windows)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.rehearsal", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--scenario", nargs="+", default=["mixed"])
    parser.add_argument("--characters", type=int, nargs="+", help="for each scenario (default: the scenario's)")
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--engines", type=int, default=2)
    parser.add_argument("--slower", type=float, default=1.25, help="factor on the time of calls, 1: idle machine")
    parser.add_argument(
        "--slows", type=float, nargs=2, default=(math.inf, 1.0), metavar=("SECONDS", "TIMES"),
        help="from this second on, calls take longer by a further factor, after sessions have been admitted",
    )  # fmt: skip
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    for index, name in enumerate(options.scenario):
        scenario = load_scenario(name)
        characters = options.characters[index] if options.characters else scenario.characters
        costs = Costs(slower=options.slower, slows=tuple(options.slows))
        config = EngineConfig(max_sessions=4096)
        found = rehearse(
            scenario, characters, options.seconds, options.seed, costs=costs, engines=options.engines, config=config
        )
        print(
            f"{name} {characters}: busy {found.busy:.0%}, {found.rows:.1f} rows a step, {found.windows} windows, "
            f"{found.restarted} restarted, {found.waste:.1%} of steps thrown away"
        )
        for priority, seen in found.outcomes.items():
            if found.frames_s[priority]:
                edits = np.percentile(seen.latencies_s or [0.0], [50, 95, 99, 100]) * 1000
                opens = np.percentile(seen.opens_s or [0.0], [50, 100]) * 1000
                print(
                    f"  {priority.name:5}: missed {seen.missed_s / found.frames_s[priority]:.2%}, "
                    f"edits p50 {edits[0]:.0f} p95 {edits[1]:.0f} p99 {edits[2]:.0f} max {edits[3]:.0f} ms, "
                    f"opens p50 {opens[0]:.0f} max {opens[1]:.0f} ms, "
                    f"refused {seen.refused}, degraded {seen.degraded} times"
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
