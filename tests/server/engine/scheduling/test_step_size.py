"""How many windows a denoising step takes, and how long a window is predicted to take."""

from __future__ import annotations

import pytest

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.types import RowStatus
from tests.server.engine.scheduling.scheduled import (
    CROWD,
    HERO,
    LATER,
    NEAR,
    next_ids,
    scheduler_of,
    step_costs,
    window_job,
)

# ---- the tightest deadline decides the size --------------------------------------------------------------------------


def test_a_step_is_as_large_as_the_tightest_deadline_allows() -> None:
    # 4 steps within 0.12 s: 0.03 s each, which is 20 rows
    tight = window_job(1, HERO, deadline=0.12)
    scheduler = scheduler_of(64, tight, *[window_job(n, CROWD) for n in range(2, 65)], costs=step_costs())
    chosen = next_ids(scheduler)
    assert chosen[0] == 1
    assert 16 <= len(chosen) <= 20
    assert len(next_ids(scheduler_of(64, *[window_job(n, CROWD) for n in range(64)], costs=step_costs()))) == 64


def test_remaining_steps_share_the_remaining_time() -> None:
    scheduler = scheduler_of(
        64, window_job(1, HERO, 0.12), *[window_job(n, CROWD) for n in range(2, 65)], costs=step_costs()
    )
    sizes = []
    now = 0.0
    for done in range(1, 5):
        batch = scheduler.schedule(now)
        sizes.append(len(batch))
        now += scheduler.costs.step.seconds(len(batch))
        scheduler.commit([RowStatus(1, done, True)])
    assert now <= 0.12
    assert sum(sizes) >= 60


@pytest.mark.parametrize(("begun", "prepare_s", "decode_s"), [(0, 0.04, 0.0), (0, 0.0, 0.04), (1, 0.04, 0.04)])
def test_step_leaves_time_to_decode_its_tightest_job_and_to_prepare_it_unless_begun(
    begun: int, prepare_s: float, decode_s: float
) -> None:
    # of 0.121 s, 0.081 are left for 4 steps: 0.02 s each, which is 10 rows
    jobs = [window_job(1, HERO, 0.121), *[window_job(n, CROWD) for n in range(2, 65)]]
    costs, free = step_costs(), step_costs()
    costs.prepare.begin(1, prepare_s)
    costs.decode.begin(1, decode_s)
    scheduler = scheduler_of(64, *jobs, costs=costs)
    scheduler.mark_prepared([1] if begun else [])
    assert len(next_ids(scheduler)) == 10
    assert len(next_ids(scheduler_of(64, *jobs, costs=free))) == 20, "if neither takes any time"


def test_step_is_not_reduced_for_a_job_that_will_be_late_anyway() -> None:
    late = window_job(1, HERO, deadline=0.01)
    scheduler = scheduler_of(64, late, *[window_job(n, CROWD) for n in range(2, 65)], costs=step_costs())
    chosen = next_ids(scheduler)
    assert chosen[0] == 1
    assert len(chosen) == 64


def test_steps_are_not_reduced_below_an_efficient_size() -> None:
    # The tight job alone would make it with 0.011 s a step; ten rows cost hardly more, and one row wastes nine tenths.
    scheduler = scheduler_of(
        64, window_job(1, HERO, 0.046), *[window_job(n, CROWD) for n in range(2, 65)], costs=step_costs()
    )
    assert len(next_ids(scheduler)) >= 7


def test_backlog_keeps_steps_large_despite_a_tight_deadline() -> None:
    # 63 windows of 4 steps take 0.3 s at the least: due in 1 s they leave the hero small steps, due in 0.5 s not.
    for due, smaller in ((1.0, True), (0.5, False)):
        crowd = [window_job(n, CROWD, due) for n in range(2, 65)]
        chosen = next_ids(scheduler_of(64, window_job(1, HERO, 0.12), *crowd, costs=step_costs()))
        assert chosen[0] == 1
        assert (len(chosen) <= 20) is smaller


def test_step_length_has_a_limit_that_a_backlog_extends() -> None:
    # 0.03 s are 20 rows, twice that 50; the greatest buckets within are 16 and 48
    for due, rows in ((LATER, 16), (0.3, 48)):
        scheduler = Scheduler(step_costs(), 64, max_step_s=0.03)
        for number in range(64):
            scheduler.add(window_job(number, CROWD, due), 1)
        assert len(next_ids(scheduler)) == rows


# ---- predictions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("own_s", "num_begun"), [(0.0, 128), (0.0004, 50), (0.001, 32)])
def test_with_time_to_spare_no_more_begin_at_once_than_an_edit_may_wait_for(own_s: float, num_begun: int) -> None:
    scheduler = scheduler_of(128, *[window_job(n, CROWD) for n in range(128)], costs=step_costs(0.001, 0.00001))
    scheduler.costs.observe_own(128, 128 * own_s)
    assert len(next_ids(scheduler)) == num_begun


def test_own_time_of_windows_counts_against_time_to_spare() -> None:
    for deadline, num_begun in ((0.3, 128), (3.0, 32)):  # their steps take 0.01 s, and the engine's own work 0.3
        jobs = [window_job(n, CROWD, deadline) for n in range(128)]
        scheduler = scheduler_of(128, *jobs, costs=step_costs(0.001, 0.00001))
        scheduler.costs.observe_own(128, 0.3)
        assert len(next_ids(scheduler)) == num_begun


def test_prediction_counts_the_windows_that_go_first() -> None:
    scheduler = Scheduler(CostTable.assumed(0.01), 4, max_evaluations=4)
    assert scheduler.predict_s(NEAR, 1.0, 4, 1) == pytest.approx(0.04)
    for n in range(7):
        scheduler.add(window_job(n, NEAR, 1.0), 1)
    assert scheduler.predict_s(NEAR, 2.0, 4, 1) == pytest.approx(0.08)
    assert scheduler.predict_s(NEAR, 0.5, 4, 1) == pytest.approx(0.04)
    assert scheduler.predict_s(HERO, 2.0, 4, 1) == pytest.approx(0.04)
    assert scheduler.predict_s(CROWD, 0.5, 4, 1) == pytest.approx(0.08)
    for n in range(7):
        scheduler.remove(n)
    assert scheduler.predict_s(NEAR, 2.0, 4, 1) == pytest.approx(0.04)


def test_prediction_counts_evaluations_not_rows() -> None:
    scheduler = Scheduler(step_costs(), 64)
    scheduler.add(window_job(1, NEAR, 1.0), 3)
    assert scheduler.predict_s(NEAR, 2.0, 4, 3) == pytest.approx(4 * 0.016)
