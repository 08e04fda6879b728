"""The search for the largest number of characters: what it tries, what it trusts, and when it ends."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_tools.bench.bracket import Bracket
from motiongen_tools.bench.load import Load
from motiongen_tools.bench.result import Result
from motiongen_tools.bench.scenario import load_scenario
from motiongen_tools.bench.search import Found, Trial, find_most
from motiongen_tools.bench.terminal import describe_found
from tests.tools.bench.made_up import make_result

LONG = 30


class Machine:
    """Serves `serves` characters in full, `serves_long` for LONG seconds; from `void_from` on runs are void."""

    def __init__(self, serves: int, serves_long: int | None = None, void_from: float = math.inf) -> None:
        self.serves, self.serves_long, self.void_from = (
            serves,
            serves if serves_long is None else serves_long,
            void_from,
        )
        self.tried: list[tuple[int, int]] = []
        self.rests = 0

    async def run(self, load: Load) -> Result:
        self.tried.append((load.characters, load.seconds))
        served = self.serves_long if load.seconds == LONG else self.serves
        missed = 0 if load.characters <= served else 200
        lag_ms = 50.0 if load.characters >= self.void_from else 0.5
        return make_result(characters=load.characters, missed=missed, lag_ms=lag_ms)

    async def rest(self) -> None:
        self.rests += 1

    async def search(self, start: int = 8) -> Found:
        noted: list[Trial] = []
        load = Load("localhost:1", load_scenario("crowd"), start, LONG, seed=1)
        found = await find_most(load, self.run, 5, noted.append, self.rest)
        assert tuple(noted) == found.trials
        assert self.rests == sum(not trial.passed for trial in noted)
        return found


@settings(deadline=None)
@given(st.integers(1, 5000), st.integers(0, 5000))
def test_a_bracket_closes_on_the_true_number(start: int, truth: int) -> None:
    bracket, tries = Bracket(start), 0
    while (characters := bracket.next()) is not None:
        assert characters >= 1
        bracket.note(characters, characters <= truth)
        tries += 1
        assert tries < 40
    assert bracket.most <= truth
    assert bracket.too_many is not None
    assert truth < bracket.too_many <= bracket.most + max(1, math.ceil(0.05 * bracket.most))


@settings(deadline=None)
@given(st.integers(1, 100), st.lists(st.booleans(), min_size=200, max_size=200))
def test_a_bracket_ends_for_any_sequence_of_answers(start: int, answers: list[bool]) -> None:
    bracket = Bracket(start)
    for passed in answers:
        if (characters := bracket.next()) is None:
            return
        bracket.note(characters, passed)
    assert bracket.next() is None


async def test_the_result_is_confirmed_by_a_longer_run() -> None:
    machine = Machine(serves=20)
    found = await machine.search()
    assert found.characters == 20
    assert machine.tried[-1] == (20, LONG)
    assert found.result is not None
    assert found.result.load.characters == 20
    assert not found.limited_by_generator


async def test_a_result_that_a_longer_run_does_not_confirm_is_lowered() -> None:
    machine = Machine(serves=20, serves_long=13)
    found = await machine.search()
    assert found.characters in (12, 13)
    assert (20, LONG) in machine.tried
    assert found.trials[-1].passed


async def test_a_search_limited_by_void_runs_says_so() -> None:
    found = await Machine(serves=1000, void_from=50).search()
    assert 46 <= found.characters < 50
    assert found.limited_by_generator


async def test_a_run_that_is_void_once_is_repeated() -> None:
    machine = Machine(serves=20)
    honest, unlucky = machine.run, iter([50.0])

    async def run(load: Load) -> Result:
        result = await honest(load)
        return result if load.characters != 16 else make_result(characters=16, lag_ms=next(unlucky, 0.5))

    machine.run = run  # type: ignore[method-assign]
    found = await machine.search()
    assert found.characters == 20
    assert machine.tried.count((16, 5)) == 2
    assert not found.limited_by_generator


async def test_a_search_may_find_that_no_character_is_served() -> None:
    found = await Machine(serves=0).search(start=5)
    assert (found.characters, found.result) == (0, None)
    assert min(trial.characters for trial in found.trials) == 1


@pytest.mark.parametrize("start", [1, 20, 300])
async def test_the_result_does_not_depend_on_the_start(start: int) -> None:
    assert (await Machine(serves=20).search(start)).characters in (19, 20)


class Hurried(Machine):
    """A machine with a clock of its own, whose runs take 10 s longer than they measure."""

    now = 0.0

    async def run(self, load: Load) -> Result:
        self.now += load.seconds + 10.0
        return await super().run(load)

    async def search_within(self, within_s: float) -> Found:
        load = Load("localhost:1", load_scenario("crowd"), 100, LONG, seed=1)
        return await find_most(load, self.run, 5, lambda _: None, self.rest, within_s=within_s, clock=lambda: self.now)


@pytest.mark.parametrize("within_s", [100.0, 130.0, 150.0])
async def test_a_search_with_a_time_limit_ends_in_time_with_its_best_result(within_s: float) -> None:
    machine = Hurried(serves=1530)
    found = await machine.search_within(within_s)
    assert machine.now <= within_s
    assert found.out_of_time
    assert found.result is not None
    assert found.characters in (100, 200, 400, 800, 1200, 1400)


async def test_a_result_without_time_to_confirm_it_is_reported_as_unconfirmed() -> None:
    machine = Hurried(serves=400, serves_long=0)
    found = await machine.search_within(130.0)
    assert (found.out_of_time, found.result) == (True, None)
    assert describe_found(replace(found, characters=8)).endswith("in the time given; that was not confirmed.")
    late = replace(found, characters=8, limited_by_generator=True)
    assert "At least 8 characters are served in full; that was not confirmed; with more" in describe_found(late)


async def test_a_search_with_ample_time_is_not_cut_short() -> None:
    found = await Hurried(serves=150).search_within(1e6)
    assert not found.out_of_time
    assert 143 <= found.characters <= 150
