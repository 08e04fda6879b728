"""Schedules: determined by seed and number, within the run, and with as many characters as asked for."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_tools.bench.scenario import BUILT_IN, load_scenario
from motiongen_tools.bench.schedule import Schedule, make_schedule

SCENARIOS = {name: load_scenario(name) for name in BUILT_IN}


def edits_of(schedule: Schedule, character: int) -> list[tuple[float, int, int]]:
    mine = schedule.edit_character == character
    columns = (schedule.edit_at_s, schedule.edit_rule, schedule.edit_value)
    return list(zip(*(column[mine].tolist() for column in columns), strict=True))


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(BUILT_IN), st.integers(1, 40), st.integers(1, 10), st.integers(0, 2**32))
def test_a_seed_determines_a_schedule_within_the_run(name: str, num_characters: int, seconds: int, seed: int) -> None:
    schedule = make_schedule(SCENARIOS[name], num_characters, seconds, seed)
    assert schedule.sha256() == make_schedule(SCENARIOS[name], num_characters, seconds, seed).sha256()
    assert schedule.sha256() != make_schedule(SCENARIOS[name], num_characters, seconds, seed + 1).sha256()
    phases = schedule.phases
    assert phases.measure_s == seconds
    assert phases.measure_from_s >= phases.ramp_s
    assert (np.diff(schedule.edit_at_s) >= 0).all()
    for plan in schedule.characters:
        assert 0 <= plan.open_s < plan.close_s
        assert plan.close_s < phases.end_s or plan.close_s == math.inf
    opens = np.array([plan.open_s for plan in schedule.characters])
    closes = np.array([min(plan.close_s, phases.end_s) for plan in schedule.characters])
    assert (schedule.edit_at_s >= opens[schedule.edit_character]).all()
    assert (schedule.edit_at_s < closes[schedule.edit_character]).all()


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "churn"])
def test_a_character_does_not_depend_on_the_number_of_characters(name: str) -> None:
    few, many = (make_schedule(SCENARIOS[name], number, 10, 7) for number in (5, 50))
    for number in range(5):
        one, other = few.characters[number], many.characters[number]
        assert (one.seed, one.prompt, one.group) == (other.seed, other.prompt, other.group)
        assert [edit[1:] for edit in edits_of(few, number)][:3] == [edit[1:] for edit in edits_of(many, number)][:3]


def test_successive_prompts_always_differ() -> None:
    schedule = make_schedule(SCENARIOS["crowd"], 10, 60, 3)
    for plan in schedule.characters:
        prompts = [plan.prompt, *(value for _, _, value in edits_of(schedule, plan.number))]
        assert len(prompts) > 10
        assert all(one != next_one for one, next_one in itertools.pairwise(prompts))


def test_regular_edits_are_spread_over_the_period() -> None:
    schedule = make_schedule(SCENARIOS["crowd"], 100, 30, 3)
    steady = schedule.edit_at_s[(schedule.edit_at_s >= 10) & (schedule.edit_at_s < 35)]
    assert len(steady) == 500
    assert np.bincount(steady.astype(int) % 5).min() > 50


def test_all_edits_of_a_storm_come_at_one_moment() -> None:
    schedule = make_schedule(SCENARIOS["storm"], 20, 20, 3)
    steady = schedule.edit_at_s[schedule.edit_at_s > SCENARIOS["storm"].ramp_s]
    moments, counts = np.unique(steady, return_counts=True)
    assert len(moments) >= 4
    assert (counts == 20).all()


def test_churn_keeps_about_the_requested_number_of_characters() -> None:
    schedule = make_schedule(SCENARIOS["churn"], 200, 60, 3)
    for at_s in range(schedule.phases.measure_from_s, schedule.phases.measure_to_s, 5):
        alive = sum(plan.open_s <= at_s < plan.close_s for plan in schedule.characters)
        assert alive == pytest.approx(200, rel=0.25)  # 3.5 standard deviations of a Poisson number
    assert len(schedule.characters) > 600
    assert schedule.most_at_once() < 260
