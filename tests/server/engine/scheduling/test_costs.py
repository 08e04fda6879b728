import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.scheduling.costs import SIZES, CallCosts, CostTable, bucket


def test_bucket_is_the_smallest_that_holds_a_size_and_is_at_most_26_percent_above() -> None:
    assert [bucket(size) for size in (1, 3, 8, 9, 11, 33, 96, 97)] == [1, 3, 8, 10, 12, 40, 96, 112]
    assert all(larger <= 1.26 * size for size, larger in itertools.pairwise(SIZES) if size >= 8)


MEASURED = st.lists(st.tuples(st.integers(1, 400), st.floats(0.0, 2.0)), min_size=1, max_size=60)


@given(MEASURED)
def test_larger_calls_never_cost_less(measured: list[tuple[int, float]]) -> None:
    costs = CallCosts(0.5)
    for size, seconds in measured:
        costs.observe(size, seconds)
    curve = [costs.seconds(size) for size in range(500)]
    assert curve == sorted(curve)
    assert curve[0] == 0.0
    assert curve[1] > 0.0


@given(MEASURED, st.floats(0.0, 2.0))
def test_largest_size_within_a_time_fits_and_the_next_size_does_not(
    measured: list[tuple[int, float]], limit_s: float
) -> None:
    costs = CallCosts(0.5)
    for size, seconds in measured:
        costs.observe(size, seconds)
    largest = costs.largest_within(limit_s)
    assert costs.seconds(largest) <= limit_s
    later = [size for size in SIZES if size > largest]
    assert all(costs.seconds(size) > limit_s for size in later[:1])


def test_every_size_has_the_assumed_cost_before_any_measurement() -> None:
    costs = CallCosts(0.5)
    assert [costs.seconds(size) for size in (0, 1, 100)] == [0.0, 0.5, 0.5]
    assert (costs.largest_within(0.4), costs.largest_within(0.6)) == (0, SIZES[-1])


def test_costs_follow_measurements() -> None:
    costs = CallCosts(0.5)
    for seconds in (0.1, 0.2):
        for _ in range(100):
            costs.observe(4, seconds)
        assert costs.seconds(4) == pytest.approx(seconds, rel=0.02)


def test_costs_are_interpolated_between_sizes_and_proportional_above_them() -> None:
    costs = CallCosts(0.5)
    costs.observe(8, 0.08)
    costs.observe(16, 0.12)
    assert costs.seconds(2) == pytest.approx(0.08)
    assert costs.seconds(12) == pytest.approx(0.10)
    assert costs.seconds(32) == pytest.approx(0.24)
    assert costs.seconds(10 * SIZES[-1]) == pytest.approx(0.12 * 10 * SIZES[-1] / 16)


def test_single_measurement_yields_to_a_size_measured_often() -> None:
    costs = CallCosts(0.5)
    costs.observe(1, 0.9)
    for _ in range(30):
        costs.observe(16, 0.1)
    assert costs.seconds(1) == costs.seconds(16) < 0.2


def test_single_stall_hardly_changes_a_cost() -> None:
    costs = CallCosts(0.5)
    for _ in range(50):
        costs.observe(4, 0.1)
    costs.observe(4, 60.0)
    for _ in range(8):
        costs.observe(4, 0.1)
    assert costs.seconds(4) < 0.13


def test_slowdown_of_one_size_raises_the_costs_of_the_others() -> None:
    costs = CallCosts(0.5)
    costs.observe(1, 0.01)
    costs.observe(64, 0.1)
    for _ in range(100):
        costs.observe(64, 0.2)
    assert 0.013 < costs.seconds(1) < 0.02


def test_stalls_raise_elapsed_time_but_not_processor_time_spent() -> None:
    table = CostTable.assumed(0.5)
    table.follow_processor()
    assert table.step.spent_each_s(4) == 0.125  # as assumed
    table.step.observe(4, 0.01, 0.01)
    for _ in range(400):
        table.step.observe(4, 0.02, 0.011)  # the processor was taken away for half of the time
    assert table.step.seconds(4) == pytest.approx(0.02, rel=0.05)
    assert table.step.spent_each_s(4) == pytest.approx(0.011 / 4, rel=0.05)


def test_higher_cost_raises_expected_time_at_once_and_price_only_if_it_lasts() -> None:
    table = CostTable.assumed(0.5)
    table.follow_processor()
    table.decode.observe(4, 0.01, 0.01)
    for _ in range(20):
        table.decode.observe(4, 0.02, 0.02)
    assert table.decode.seconds(4) > 0.015
    assert table.decode.spent_each_s(4) < 0.013 / 4
    for _ in range(20):
        table.decode.observe(4, 0.02, 0.02)
    assert table.decode.seconds(4) > 0.017
    for _ in range(160):
        table.decode.observe(4, 0.02, 0.02)
    assert table.decode.spent_each_s(4) > 0.018 / 4


def _small_and_large() -> CostTable:
    """Costs where steps of size 4 take 10 ms of processor time, and steps of size 64 take 100 ms."""
    table = CostTable.assumed(0.5)
    table.follow_processor()
    for size, seconds in ((4, 0.01), (64, 0.1)):
        table.step.observe(size, seconds, seconds)
    return table


def test_costlier_small_calls_do_not_raise_the_price_of_large_ones_also_made() -> None:
    table = _small_and_large()
    for _ in range(50):
        for size, seconds in ((4, 0.02), (4, 0.02), (4, 0.02), (4, 0.02), (64, 0.1)):
            table.step.observe(size, seconds, seconds)
    assert table.step.spent_each_s(64) == pytest.approx(0.1 / 64, rel=0.05)


def test_price_of_large_calls_follows_small_ones_if_only_those_are_made() -> None:
    table = _small_and_large()
    for _ in range(100):
        table.step.observe(4, 0.02, 0.02)
    assert table.step.spent_each_s(64) > 1.2 * 0.1 / 64


def test_all_elapsed_time_is_spent_if_processor_time_is_not_measured() -> None:
    costs = CallCosts(0.5)
    for seconds in (0.01, 0.01, 0.013, 0.02):
        costs.observe(4, seconds)
    assert costs.spent_each_s(4) == costs.each_s(4)


def test_cost_that_was_measured_as_zero_can_rise() -> None:
    costs = CallCosts(0.0)
    for _ in range(20):
        costs.observe(4, 0.0)
    for _ in range(200):
        costs.observe(4, 0.1)
    assert costs.seconds(4) == pytest.approx(0.1, rel=0.1)


def test_small_calls_are_efficient_with_proportional_but_not_with_fixed_costs() -> None:
    proportional, fixed = CallCosts(0.5), CallCosts(0.5)
    for size in (1, 4, 16, 64):
        proportional.observe(size, 0.01 * size)
        fixed.observe(size, 0.1)
    assert proportional.efficient_from(64, 2.0) == 1
    assert fixed.efficient_from(64, 2.0) == 32


def _table() -> CostTable:
    table = CostTable.assumed(0.5)
    for size in (1, 2, 4, 8, 16, 32, 64, 96):
        table.step.observe(size, 0.01 + 0.001 * size)
        table.prepare.observe(size, 0.002 * size)
        table.decode.observe(size, 0.003 * size)
    return table


def test_window_time_includes_windows_prepared_and_decoded_meanwhile() -> None:
    table = _table()
    # 32 rows of 4 steps: in every round 8 windows are prepared and 8 decoded
    assert table.round_s(96, 32, 4) == pytest.approx(0.106 + 8 * 0.005)
    assert table.window_s(4, 6, 96, 32) == pytest.approx(6 * (0.106 + 8 * 0.005))


def test_unsteady_costs_are_predicted_with_a_margin() -> None:
    table = CostTable.assumed(0.5)
    for n in range(200):
        table.step.observe(1, 0.1 if n % 2 else 0.3)
    assert table.window_s(1, 1, 1, 1) > 0.3


def test_calls_that_include_stalls_have_their_average_cost() -> None:
    costs = CallCosts(0.5)
    for size in (1, 4, 16, 64):
        costs.observe(size, 0.01 + 0.001 * size)
    of_each = {size: 0.01 + 0.001 * size for size in (4, 16)}
    computed_s = 0.0
    found = []
    for number in range(3000):  # calls run for 50 ms of each 100 ms, and stall for the other 50 ms
        size = 4 if number % 3 else 16
        before, computed_s = computed_s, computed_s + of_each[size]
        stalls = int(computed_s / 0.05) - int(before / 0.05)
        costs.observe(size, of_each[size] + 0.05 * stalls)
        found.append(costs.seconds(64) / 0.074)
    assert sum(found[500:]) / len(found[500:]) == pytest.approx(2.0, rel=0.15)


def test_short_calls_with_rare_long_stalls_have_their_average_cost() -> None:
    costs = CallCosts(0.5)
    costs.observe(1, 0.004)
    computed_s = 0.0
    found = []
    for _ in range(4000):  # stalls as above: one call in twelve takes fourteen times as long as the others
        before, computed_s = computed_s, computed_s + 0.004
        stalls = int(computed_s / 0.05) - int(before / 0.05)
        costs.observe(1, 0.004 + 0.05 * stalls)
        found.append(costs.seconds(1) / 0.004)
    assert sum(found[500:]) / len(found[500:]) == pytest.approx(2.0, rel=0.1)


def test_first_call_of_a_size_between_measured_ones_counts_little() -> None:
    costs = CallCosts(0.5)
    for size in (8, 32):
        costs.observe(size, 0.01 * size)
    costs.observe(16, 0.5)
    assert costs.seconds(16) == pytest.approx(0.16, rel=0.15)


def _profiled() -> CallCosts:
    """Profiled costs of sizes 2 to 128: 2 ms, and half a millisecond for each item."""
    costs = CallCosts(0.5)
    for size in (2, 4, 8, 16, 32, 64, 128):
        costs.begin(size, 0.002 + 0.0005 * size)
    return costs


def test_profiled_costs_are_taken_as_they_are() -> None:
    costs = CallCosts(0.5)
    for size, seconds in ((1, 0.003), (2, 0.012), (64, 2.0)):
        costs.begin(size, seconds)
        assert costs.seconds(size) == pytest.approx(seconds)
    assert costs.pace.value == 1.0


@pytest.mark.parametrize("stall_s", [0.2, 60.0])
def test_stall_in_the_first_call_of_a_new_largest_size_does_not_exclude_it(stall_s: float) -> None:
    costs = _profiled()
    costs.observe(160, stall_s)
    for _ in range(200):
        costs.observe(64, 0.034)
    assert costs.seconds(160) == pytest.approx(0.082, rel=0.1)
    assert costs.largest_within(0.1) >= 160


@pytest.mark.parametrize("stall_s", [0.05, 0.3, 60.0])
def test_stall_in_the_first_call_of_a_new_smallest_size_raises_no_cost(stall_s: float) -> None:
    costs = _profiled()
    costs.observe(1, stall_s)
    for _ in range(200):
        costs.observe(64, 0.034)
    for size in (1, 2, 4, 8):
        assert costs.seconds(size) == pytest.approx(0.002 + 0.0005 * max(size, 2), rel=0.05)


def test_first_call_of_a_new_smallest_or_largest_size_counts_if_faster() -> None:
    costs = _profiled()
    costs.observe(1, 0.0025)
    costs.observe(256, 0.13)
    assert costs.seconds(1) == pytest.approx(0.0025)
    assert costs.seconds(256) == pytest.approx(0.13)
    assert costs.pace.value == 1.0
