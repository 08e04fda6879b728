"""The search for the most characters."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tests.bench.trial import most_characters


@given(limit=st.integers(0, 3000), guess=st.integers(-5, 4000))
def test_the_search_ends_close_below_the_limit(limit: int, guess: int) -> None:
    found = most_characters(lambda number: number <= limit, guess, num_trials=60)
    assert found <= limit
    assert limit - found <= max(1, found // 16)


@given(limit=st.integers(1, 3000), guess=st.integers(1, 4000), num_trials=st.integers(1, 6))
def test_only_what_passed_is_found_and_trials_are_few(limit: int, guess: int, num_trials: int) -> None:
    tried: list[int] = []

    def passes(number: int) -> bool:
        tried.append(number)
        return number <= limit

    found = most_characters(passes, guess, num_trials)
    assert found in tried
    assert found <= limit
    assert sum(number <= limit for number in tried) <= num_trials
