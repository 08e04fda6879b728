"""Which windows the next denoising step takes first."""

from __future__ import annotations

from dataclasses import replace

import pytest

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.types import PlanCause, Priority, RowStatus, WindowJob
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

# ---- order -----------------------------------------------------------------------------------------------------------


def test_jobs_are_ordered_by_class_and_within_it_by_deadline() -> None:
    scheduler = scheduler_of(
        8, window_job(1, NEAR, 3.0), window_job(2, NEAR, 1.0), window_job(3, HERO, 9.0), window_job(4, NEAR, 2.0)
    )
    assert next_ids(scheduler) == [3, 2, 4, 1]
    scheduler.remove(2)
    assert next_ids(scheduler) == [3, 4, 1]


def test_rows_and_evaluations_of_a_step_are_capped() -> None:
    jobs = [window_job(n, NEAR, n) for n in range(20)]
    assert len(next_ids(scheduler_of(8, *jobs))) == 8
    scheduler = Scheduler(CostTable.assumed(0.02), 8, max_evaluations=10)
    for job in jobs:
        scheduler.add(job, 3)
    assert next_ids(scheduler) == [0, 1, 2]


def test_a_job_larger_than_the_cap_runs_alone_rather_than_never() -> None:
    scheduler = Scheduler(CostTable.assumed(0.02), 8, max_evaluations=2)
    scheduler.add(window_job(1, NEAR), 3)
    assert next_ids(scheduler) == [1]


def test_step_takes_no_longer_than_max_step_s() -> None:
    scheduler = Scheduler(step_costs(0.002, 0.001), 64, max_step_s=0.02)
    for n in range(64):
        scheduler.add(window_job(n, NEAR), 1)
    assert 14 <= len(next_ids(scheduler)) <= 18


# ---- frames before replans -------------------------------------------------------------------------------------------


def _going_on(job_id: int, priority: Priority, deadline: float) -> WindowJob:
    return replace(window_job(job_id, priority, deadline), first_frame=40, runs_out_at=deadline)


def _edit(job_id: int, priority: Priority, deadline: float) -> WindowJob:
    return replace(
        window_job(job_id, priority, deadline), first_frame=40, cause=PlanCause.EDIT, runs_out_at=deadline + LATER
    )


def test_windows_of_sessions_about_to_run_out_come_before_replans() -> None:
    # 4 steps of 0.02 s take 0.08 s; the crowd's frames are at risk from twice that on
    heroes = [_edit(number, HERO, 0.05) for number in range(4)]
    for deadline, endangered in ((0.15, True), (0.5, False)):
        chosen = next_ids(scheduler_of(4, *heroes, _going_on(9, CROWD, deadline)))
        assert (9 in chosen) is endangered
        assert len(chosen) == 4


@pytest.mark.parametrize("under_quota", [False, True])
def test_windows_at_risk_come_first_earlier_under_a_quota(under_quota: bool) -> None:
    scheduler = Scheduler(CostTable.assumed(0.02), 4, under_quota=under_quota)
    for job in (*(_edit(number, HERO, 0.05) for number in range(4)), _going_on(9, CROWD, 0.2)):
        scheduler.add(job, 1)
    assert (9 in next_ids(scheduler)) is under_quota


@pytest.mark.parametrize("longest_left", [True, False])
def test_long_window_is_at_risk_sooner_than_short_ones_due_before_it(longest_left: bool) -> None:
    # 40 steps of 0.02 s take 0.8 s: at risk from twice that on. The short ones before it take 0.04 s.
    short = [replace(_going_on(number, CROWD, 1.4), num_steps=2) for number in range(10, 13)]
    long = replace(_going_on(9, CROWD, 1.5), num_steps=40)
    scheduler = scheduler_of(4, *[_edit(number, HERO, 0.05) for number in range(4)], *short, long)
    if not longest_left:
        scheduler.remove(9)
        scheduler.add(replace(long, num_steps=2), 1)
    chosen = next_ids(scheduler)
    assert (9 in chosen) is longest_left
    assert not {10, 11, 12} & set(chosen)


def test_edit_of_a_crowd_session_precedes_a_hero_only_once_it_is_late() -> None:
    heroes = [_edit(number, HERO, 0.05) for number in range(4)]
    scheduler = scheduler_of(4, *heroes, _edit(9, CROWD, 0.01))
    assert next_ids(scheduler, now=0.009) == [0, 1, 2, 3]
    assert 9 in next_ids(scheduler, now=0.011)


def test_late_windows_of_all_classes_come_by_deadline() -> None:
    late = _edit(4, CROWD, 1.0), _edit(5, NEAR, 2.0), _edit(6, HERO, 3.0), _edit(7, NEAR, 4.0)
    for rows, expected in ((1, {4}), (2, {4, 5}), (3, {4, 5, 6})):
        assert set(next_ids(scheduler_of(rows, *late), now=5.0)) == expected


def test_late_window_does_not_precede_one_that_has_begun() -> None:
    begun, late = _edit(1, HERO, 9.0), _edit(2, CROWD, 1.0)
    scheduler = _under_way(scheduler_of(1, begun, late), 1)
    assert next_ids(scheduler, now=5.0) == [1]


def test_windows_of_its_class_that_have_begun_come_before_a_late_one() -> None:
    begun, late, hero = _edit(1, CROWD, 9.0), _edit(2, CROWD, 1.0), _edit(3, HERO, 6.0)
    scheduler = _under_way(scheduler_of(2, begun, late, hero), 1)
    assert set(next_ids(scheduler, now=5.0)) == {1, 2}


def test_late_window_of_the_background_waits() -> None:
    clip = replace(window_job(9, HERO, 1.0), background=True)
    assert next_ids(scheduler_of(1, clip, _edit(1, CROWD, 6.0)), now=5.0) == [1]


def test_of_windows_at_risk_the_most_urgent_class_comes_first() -> None:
    crowd = [_going_on(number, CROWD, 0.01) for number in range(4)]
    assert next_ids(scheduler_of(2, *crowd, _going_on(9, HERO, 0.1)))[0] == 9


def test_edit_of_a_session_about_to_run_out_precedes_replans() -> None:
    heroes = [_edit(number, HERO, 0.05) for number in range(8)]
    late = replace(_edit(9, CROWD, 0.3), runs_out_at=0.3)
    for now, endangered in ((0.0, False), (0.25, True)):
        assert (9 in next_ids(scheduler_of(4, *heroes, late), now)) is endangered


# ---- new windows gather ----------------------------------------------------------------------------------------------


def _under_way(scheduler: Scheduler, *job_ids: int, steps_done: int = 1) -> Scheduler:
    scheduler.mark_prepared(job_ids)
    scheduler.commit([RowStatus(job_id, steps_done, True) for job_id in job_ids])
    return scheduler


def test_new_windows_wait_for_nearly_finished_ones_and_begin_together() -> None:
    scheduler = scheduler_of(8, *[_edit(number, HERO, 0.05) for number in range(4)])
    _under_way(scheduler, 0, 1)
    assert next_ids(scheduler) == [0, 1]
    for job_id in (0, 1):
        scheduler.remove(job_id)
    assert next_ids(scheduler) == [2, 3]


@pytest.mark.parametrize(("step_s", "wait"), [(0.039, True), (0.041, False)])
def test_new_windows_do_not_wait_long_for_running_ones(step_s: float, wait: bool) -> None:
    jobs = _edit(0, HERO, 0.05), _edit(1, HERO, 0.05)
    scheduler = _under_way(scheduler_of(8, *jobs, costs=CostTable.assumed(step_s)), 0)  # which has three steps to go
    assert next_ids(scheduler) == ([0] if wait else [0, 1])


@pytest.mark.parametrize(("step_s", "wait"), [(0.019, True), (0.021, False)])
def test_new_windows_wait_half_as_long_for_a_more_urgent_class(step_s: float, wait: bool) -> None:
    jobs = _edit(0, HERO, 0.05), _edit(1, CROWD, 1.0)
    scheduler = _under_way(scheduler_of(8, *jobs, costs=CostTable.assumed(step_s)), 0)
    assert next_ids(scheduler) == ([0] if wait else [0, 1])


def test_begun_windows_go_first_within_a_class() -> None:
    # No window waits here: those under way still need too long.
    windows = [_edit(number, HERO, 8.0 + number) for number in range(4)]
    scheduler = _under_way(scheduler_of(3, *windows, costs=CostTable.assumed(0.1)), 2, 3)
    assert next_ids(scheduler) == [0, 2, 3]
    scheduler = _under_way(scheduler_of(2, *windows, costs=CostTable.assumed(0.1)), 2, 3)
    assert next_ids(scheduler) == [2, 3]


def test_rows_owed_to_a_class_go_to_its_begun_windows() -> None:
    heroes = [_edit(number, HERO, 9.0) for number in range(20)]
    crowd = [_edit(number, CROWD, 9.0 + number) for number in (30, 31)]
    scheduler = scheduler_of(10, *heroes, *crowd, costs=CostTable.assumed(0.1))
    _under_way(scheduler, 31)
    assert [[job_id for job_id in next_ids(scheduler) if job_id >= 30] for _ in range(2)] == [[], [31]]


@pytest.mark.parametrize(
    ("others", "num_begun", "num_chosen"), [(HERO, 64, 64), (CROWD, 64, 24), (HERO, 1, 24), (HERO, 0, 24)]
)
def test_step_of_begun_windows_is_not_reduced_for_a_deadline_in_their_class(
    others: Priority, num_begun: int, num_chosen: int
) -> None:
    # 4 steps within 0.15 s are 24 rows as rows are counted; a group that falls apart would be decoded in parts.
    jobs = [_edit(0, HERO, 0.15), *[_edit(number, others, LATER) for number in range(1, 64)]]
    scheduler = Scheduler(step_costs(), 64, gather_s=0.0)
    for job in jobs:
        scheduler.add(job, 1)
    scheduler.mark_prepared(range(num_begun))
    assert len(next_ids(scheduler)) == num_chosen


def test_new_windows_do_not_wait_for_a_less_urgent_class() -> None:
    scheduler = scheduler_of(8, _edit(0, CROWD, 1.0), _edit(1, HERO, 0.05))
    assert next_ids(_under_way(scheduler, 0)) == [1, 0]


def test_windows_at_risk_do_not_wait_to_begin_together() -> None:
    scheduler = scheduler_of(8, _edit(0, HERO, 0.05), _going_on(1, CROWD, 0.1))
    assert next_ids(_under_way(scheduler, 0)) == [0, 1]


def test_waiting_window_can_be_moved_to_another_class() -> None:
    scheduler = scheduler_of(8, window_job(1, CROWD, 1.0), window_job(2, CROWD, 2.0), window_job(3, HERO, 3.0))
    scheduler.exchange(window_job(1, HERO, 1.0), 3)
    assert next_ids(scheduler) == [1, 3, 2]
    for job_id in (1, 2, 3):
        scheduler.remove(job_id)
    assert next_ids(scheduler) == []
    scheduler.add(window_job(4, CROWD), 1)
    assert next_ids(scheduler) == [4], "removed windows leave nothing behind"
