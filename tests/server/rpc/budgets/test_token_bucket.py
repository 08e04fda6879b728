"""The token bucket: bursts of a second's worth, and no more than the rate over time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.rpc.budgets.token_bucket import TokenBucket


def test_a_second_s_worth_may_come_at_once() -> None:
    bucket = TokenBucket(5.0, 100.0)
    assert [bucket.take(100.0) for _ in range(6)] == [True] * 5 + [False]


def test_tokens_come_back_at_the_rate() -> None:
    bucket = TokenBucket(4.0, 0.0)
    while bucket.take(0.0):
        pass
    assert not bucket.take(0.125)
    assert bucket.take(0.25)
    assert not bucket.take(0.25)


def test_rest_saves_up_one_second_and_no_more() -> None:
    bucket = TokenBucket(3.0, 0.0)
    assert sum(bucket.take(1e6) for _ in range(10)) == 3


@given(st.floats(1.0, 100.0), st.lists(st.floats(0.0, 0.5), max_size=200))
def test_never_more_than_the_rate_over_time_and_one_burst(rate: float, pauses: list[float]) -> None:
    now, taken = 0.0, 0
    bucket = TokenBucket(rate, now)
    for pause in pauses:
        now += pause
        taken += bucket.take(now)
    assert taken <= rate * (1 + now) + 1e-6


@pytest.mark.parametrize("rate", [1.0, 50.0])
def test_who_keeps_to_the_rate_is_never_refused(rate: float) -> None:
    bucket = TokenBucket(rate, 0.0)
    assert all(bucket.take(number / rate) for number in range(500))
