"""Simulated days in virtual time; `python -m tests.bench.simulate` runs many more."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_server.engine.scheduling.owed_rows import OwedRows
from tests.server.engine.day import Day
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.watched import PromiseBroken, WatchedScheduler

NUM_STEPS = 4_000


@pytest.mark.parametrize("seed", [2, 4])
def test_long_simulated_day_breaks_no_rule(seed: int) -> None:
    day = Day(seed)
    day.live(NUM_STEPS)
    day.end()
    # The day was eventful enough to show something: each of these did happen.
    for happened in ("windows_restarted", "frames_superseded", "runner_faults", "closes", "deadline_misses"):
        assert day.stage.total(happened) > 0, happened


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**9))
def test_short_simulated_days_break_no_rule(seed: int) -> None:
    day = Day(seed)
    day.live(600)
    day.end()


def test_simulation_catches_a_scheduler_whose_rows_are_out_of_order(monkeypatch: pytest.MonkeyPatch) -> None:
    schedule = WatchedScheduler.__bases__[0].schedule
    monkeypatch.setattr(WatchedScheduler.__bases__[0], "schedule", lambda self, now: schedule(self, now)[::-1])
    day = Day(1)
    with pytest.raises(PromiseBroken, match="out of order"):
        day.live(NUM_STEPS)


def test_simulation_catches_a_starved_priority_class(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OwedRows, "settle", lambda *given: None)  # no class is ever owed a row
    with pytest.raises(PromiseBroken, match="has waited"):
        _live(range(20))


def _live(seeds: range) -> None:
    for seed in seeds:
        Day(seed).live(2_000)


def test_a_replay_of_the_same_events_gives_the_same_motion() -> None:
    def play() -> list[list[float]]:
        stage = Stage()
        viewers = [stage.open(handle, seed=handle, prompts=(prompt(1),)) for handle in (1, 2, 3)]
        stage.run(2.0)
        stage.set_prompts(viewers[0], prompt(2))
        stage.run(3.0)
        return [row.tolist() for viewer in viewers for row in viewer.rows]

    assert play() == play()
