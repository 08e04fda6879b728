"""The token bucket: bursts of a second's worth, and no more than the rate over time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket


def test_one_second_of_tokens_may_be_taken_at_once() -> None:
    bucket = TokenBucket(5.0, 100.0)
    assert [bucket.take(100.0) for _ in range(6)] == [True] * 5 + [False]


def test_tokens_are_replenished_at_the_rate() -> None:
    bucket = TokenBucket(4.0, 0.0)
    while bucket.take(0.0):
        pass
    assert not bucket.take(0.125)
    assert bucket.take(0.25)
    assert not bucket.take(0.25)


def test_idle_bucket_saves_up_one_second_and_no_more() -> None:
    bucket = TokenBucket(3.0, 0.0)
    assert sum(bucket.take(1e6) for _ in range(10)) == 3


@given(st.floats(1.0, 100.0), st.lists(st.floats(0.0, 0.5), max_size=200))
def test_no_more_than_the_rate_and_one_burst_is_ever_taken(rate: float, pauses: list[float]) -> None:
    now, taken = 0.0, 0
    bucket = TokenBucket(rate, now)
    for pause in pauses:
        now += pause
        taken += bucket.take(now)
    assert taken <= rate * (1 + now) + 1e-6


@pytest.mark.parametrize("rate", [1.0, 50.0])
def test_user_that_keeps_to_the_rate_is_never_refused(rate: float) -> None:
    bucket = TokenBucket(rate, 0.0)
    assert all(bucket.take(number / rate) for number in range(500))


def test_lower_rate_cuts_what_was_saved_to_one_second_of_it() -> None:
    bucket = TokenBucket(100.0, 0.0)
    bucket.set_rate(10.0, 0.0)
    assert bucket.left(0.0) == 10.0
    bucket.charge(15.0, 0.0)
    bucket.set_rate(100.0, 0.25)
    assert bucket.owed_s(0.25) == pytest.approx(0.025), "2.5 came back at the earlier rate"


def test_refund_saves_up_no_more_than_one_second() -> None:
    for bucket in (TokenBucket(10.0, 0.0), Share(TokenBucket(20.0, 0.0), lambda: 2, 0.0)):
        bucket.charge(8.0, 0.0)
        bucket.give_back(3.0, 0.0)
        assert bucket.left(0.0) == 5.0
        bucket.give_back(100.0, 0.0)
        assert bucket.left(0.0) == 10.0


# Amounts and pauses of which all sums are exact: otherwise rounding puts a user that keeps to its part beyond it.
AMOUNTS = st.integers(0, 40 * 64).map(lambda parts: parts / 64)
PAUSES_S = st.integers(0, 64).map(lambda parts: parts / 64)


@given(st.integers(1, 6), st.lists(st.tuples(st.integers(0, 5), AMOUNTS, PAUSES_S), max_size=60))
def test_shares_together_stay_within_the_bucket_and_a_fair_user_never_waits(
    num_users: int, charges: list[tuple[int, float, float]]
) -> None:
    """All but the first charge whenever they may; the first charges no more than its part."""
    bucket, now = TokenBucket(60.0, 0.0), 0.0
    shares = [Share(bucket, lambda: num_users, now) for _ in range(num_users)]
    part, taken, over = 60.0 / num_users, 0.0, 0.0
    saved = part
    for number, amount, pause_s in charges:
        now += pause_s
        saved = min(part, saved + pause_s * part)
        share = shares[number % num_users]
        if share is shares[0]:
            amount = min(amount, saved)
            saved -= amount
            assert share.owed_s(now) == 0.0
        elif share.owed_s(now) > 0.0:
            assert share.ahead_s(now) >= share.owed_s(now)
            continue
        share.charge(amount, now)
        taken += amount
        over = max(over, amount)
        assert taken <= 60.0 * (now + 1.0) + num_users * (part + over) + 1e-6


@pytest.mark.parametrize("rest_s", [0.0, 0.5, 1.0, 3600.0])
def test_charge_beyond_one_second_is_owed_however_long_the_rest_before(rest_s: float) -> None:
    bucket, now = TokenBucket(10.0, 5.0), 5.0 + rest_s
    bucket.charge(25.0, now)
    assert bucket.owed_s(now) == 1.5
    shared = TokenBucket(20.0, 5.0)
    mine, others = (Share(shared, lambda: 2, 5.0) for _ in range(2))
    others.charge(10.0, now)
    mine.charge(25.0, now)
    assert (mine.owed_s(now), others.owed_s(now)) == (0.75, 0.0), (
        "together they owe fifteen, and twenty a second come back"
    )
