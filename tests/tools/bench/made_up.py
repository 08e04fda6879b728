"""Synthetic results of runs, with given numbers of missed frames, lag and edits."""

from __future__ import annotations

from motiongen_tools.bench.load import Load
from motiongen_tools.bench.recorder import EVENT, GENERATOR, LOOP_LAG, OPEN, SEND_LAG, Recorder
from motiongen_tools.bench.result import Result, Standard
from motiongen_tools.bench.scenario import Scenario, load_scenario

SECONDS = 5


def make_result(
    *,
    scenario: str | Scenario = "crowd",
    characters: int = 10,
    missed: int = 0,
    lag_ms: float = 0.5,
    counts: dict[str, int] | None = None,
    hero_underruns: int = 0,
) -> Result:
    """1,000 frames due in each group, and edits that took 1 to 100 ms."""
    played = load_scenario(scenario) if isinstance(scenario, str) else scenario
    load = Load("localhost:1", played, characters, SECONDS, seed=1)
    schedule = load.schedule()
    phases = schedule.phases
    recorder = load.new_book(phases)
    for group in played.groups:
        recorder.add("due", group.name, phases.measure_from_s, 1000)
        recorder.record(OPEN, group.name, 0.02)
        for milliseconds in range(1, 101):
            recorder.record(EVENT, group.name, milliseconds / 1000)
    recorder.add("missed", played.groups[-1].name, phases.measure_from_s, missed)
    recorder.add("missed", played.groups[-1].name, phases.measure_from_s - 1, 500)  # while warming up
    recorder.add("underruns", played.groups[0].name, phases.measure_from_s, hero_underruns)
    for what in (SEND_LAG, LOOP_LAG):
        for _ in range(100):
            recorder.record(what, GENERATOR, lag_ms / 1000)
    recorder.counts.update(counts or {})
    return Result(
        started_at="2026-01-01T00:00:00+00:00",
        load=load,
        schedule_sha256=schedule.sha256(),
        phases=phases,
        server={"address": "localhost:1"},
        machine={"processor": "a <fast> one"},
        streams=1,
        recorder=recorder,
        generator_cores=(0.1,),
        server_use=None,
        standard=Standard(),
    )


def book_with(*seconds: float) -> Recorder:
    """A recorder with events of one group that took these times."""
    recorder = Recorder(("crowd",), 10)
    for each in seconds:
        recorder.record(EVENT, "crowd", each)
    return recorder
