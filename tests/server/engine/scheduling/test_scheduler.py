from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduler import DEFAULT_SHARES, Scheduler
from motiongen_server.engine.types import Guidance, PlanCause, Priority, RowStatus, SessionKey, WindowJob

HERO, NEAR, CROWD, BATCH = Priority
LATER = 1000.0


def _job(job_id: int, priority: Priority, deadline: float = LATER, num_steps: int = 4) -> WindowJob:
    return WindowJob(
        job_id=job_id,
        session=SessionKey(1, job_id),
        plan=1,
        first_frame=0,
        history=np.empty((0, 3), np.float32),
        start_pose=None,
        embedding=None,
        constraints=(),
        seed=1,
        num_steps=num_steps,
        guidance=Guidance(2.0, 2.0),
        deadline=deadline,
        priority=priority,
        cause=PlanCause.CONTINUE,
        created_at=0.0,
    )


def _costs(fixed_s: float = 0.01, each_s: float = 0.001) -> CostTable:
    """A step of e evaluations costs fixed_s + e * each_s; the rest costs nothing."""
    costs = CostTable.assumed(fixed_s)
    for size in (1, 2, 4, 8, 16, 32, 64, 128):
        costs.step.observe(size, fixed_s + each_s * size)
    return costs


def _scheduler(max_rows: int, *jobs: WindowJob, passes: int = 1, costs: CostTable | None = None) -> Scheduler:
    scheduler = Scheduler(costs or CostTable.assumed(0.02), max_rows)
    for job in jobs:
        scheduler.add(job, passes)
    return scheduler


def _ids(scheduler: Scheduler, now: float = 0.0) -> list[int]:
    return [held.job.job_id for held in scheduler.schedule(now)]


# ---- order -----------------------------------------------------------------------------------------------------------


def test_the_earliest_deadline_goes_first_within_a_class_and_classes_in_order() -> None:
    scheduler = _scheduler(8, _job(1, NEAR, 3.0), _job(2, NEAR, 1.0), _job(3, HERO, 9.0), _job(4, NEAR, 2.0))
    assert _ids(scheduler) == [3, 2, 4, 1]
    scheduler.remove(2)
    assert _ids(scheduler) == [3, 4, 1]


def test_rows_and_evaluations_are_capped() -> None:
    jobs = [_job(n, NEAR, n) for n in range(20)]
    assert len(_ids(_scheduler(8, *jobs))) == 8
    scheduler = Scheduler(CostTable.assumed(0.02), 8, max_evaluations=10)
    for job in jobs:
        scheduler.add(job, 3)
    assert _ids(scheduler) == [0, 1, 2]


def test_a_job_larger_than_the_cap_runs_alone_rather_than_never() -> None:
    scheduler = Scheduler(CostTable.assumed(0.02), 8, max_evaluations=2)
    scheduler.add(_job(1, NEAR), 3)
    assert _ids(scheduler) == [1]


def test_a_step_takes_no_longer_than_newcomers_may_wait() -> None:
    scheduler = Scheduler(_costs(0.002, 0.001), 64, max_step_s=0.02)
    for n in range(64):
        scheduler.add(_job(n, NEAR), 1)
    assert 14 <= len(_ids(scheduler)) <= 18


# ---- frames before replans -------------------------------------------------------------------------------------------


def _going_on(job_id: int, priority: Priority, deadline: float) -> WindowJob:
    return replace(_job(job_id, priority, deadline), first_frame=40, runs_out_at=deadline)


def _edit(job_id: int, priority: Priority, deadline: float) -> WindowJob:
    return replace(_job(job_id, priority, deadline), first_frame=40, cause=PlanCause.EDIT, runs_out_at=deadline + LATER)


def test_frames_that_somebody_would_run_out_of_come_before_anybodys_replan() -> None:
    # 4 steps of 0.02 s take 0.08 s; the crowd's frames are endangered from twice that on
    heroes = [_edit(number, HERO, 0.05) for number in range(4)]
    for deadline, endangered in ((0.15, True), (0.5, False)):
        chosen = _ids(_scheduler(4, *heroes, _going_on(9, CROWD, deadline)))
        assert (9 in chosen) is endangered
        assert len(chosen) == 4


def test_an_edit_of_the_crowd_never_passes_a_hero() -> None:
    heroes = [_edit(number, HERO, 0.05) for number in range(4)]
    assert _ids(_scheduler(4, *heroes, _edit(9, CROWD, 0.01))) == [0, 1, 2, 3]


def test_of_those_who_would_run_out_of_frames_the_most_urgent_class_comes_first() -> None:
    crowd = [_going_on(number, CROWD, 0.01) for number in range(4)]
    assert _ids(_scheduler(2, *crowd, _going_on(9, HERO, 0.1)))[0] == 9


def test_an_edit_whose_session_runs_out_of_frames_meanwhile_is_no_less_urgent() -> None:
    heroes = [_edit(number, HERO, 0.05) for number in range(8)]
    late = replace(_edit(9, CROWD, 0.3), runs_out_at=0.3)
    for now, endangered in ((0.0, False), (0.25, True)):
        assert (9 in _ids(_scheduler(4, *heroes, late), now)) is endangered


# ---- newcomers gather ------------------------------------------------------------------------------------------------


def _under_way(scheduler: Scheduler, *job_ids: int, steps_done: int = 1) -> Scheduler:
    scheduler.mark_prepared(job_ids)
    scheduler.commit([RowStatus(job_id, steps_done, True) for job_id in job_ids])
    return scheduler


def test_newcomers_wait_for_windows_that_will_soon_be_done_and_begin_together() -> None:
    scheduler = _scheduler(8, *[_edit(number, HERO, 0.05) for number in range(4)])
    _under_way(scheduler, 0, 1)
    assert _ids(scheduler) == [0, 1]
    for job_id in (0, 1):
        scheduler.remove(job_id)
    assert _ids(scheduler) == [2, 3]


def test_newcomers_do_not_wait_long() -> None:
    scheduler = _scheduler(8, _edit(0, HERO, 0.05), _edit(1, HERO, 0.05), costs=CostTable.assumed(0.04))
    assert _ids(_under_way(scheduler, 0)) == [0, 1]  # three steps of 0.04 s are left


def test_newcomers_do_not_wait_for_a_class_below_theirs() -> None:
    scheduler = _scheduler(8, _edit(0, CROWD, 1.0), _edit(1, HERO, 0.05))
    assert _ids(_under_way(scheduler, 0)) == [1, 0]


def test_frames_in_danger_do_not_wait_for_company() -> None:
    scheduler = _scheduler(8, _edit(0, HERO, 0.05), _going_on(1, CROWD, 0.1))
    assert _ids(_under_way(scheduler, 0)) == [0, 1]


# ---- the tightest deadline decides the size --------------------------------------------------------------------------


def test_a_step_is_as_large_as_the_tightest_deadline_allows() -> None:
    # 4 steps within 0.12 s: 0.03 s each, which is 20 rows
    tight = _job(1, HERO, deadline=0.12)
    scheduler = _scheduler(64, tight, *[_job(n, CROWD) for n in range(2, 65)], costs=_costs())
    chosen = _ids(scheduler)
    assert chosen[0] == 1
    assert 16 <= len(chosen) <= 20
    assert len(_ids(_scheduler(64, *[_job(n, CROWD) for n in range(64)], costs=_costs()))) == 64


def test_the_steps_that_are_left_share_the_time_that_is_left() -> None:
    scheduler = _scheduler(64, _job(1, HERO, 0.12), *[_job(n, CROWD) for n in range(2, 65)], costs=_costs())
    sizes = []
    now = 0.0
    for done in range(1, 5):
        batch = scheduler.schedule(now)
        sizes.append(len(batch))
        now += scheduler.costs.step.seconds(len(batch))
        scheduler.commit([RowStatus(1, done, True)])
    assert now <= 0.12
    assert sum(sizes) >= 60


def test_what_prepare_and_decode_take_counts() -> None:
    scheduler = _scheduler(64, _job(1, HERO, 0.12), *[_job(n, CROWD) for n in range(2, 65)], costs=_costs())
    before = len(_ids(scheduler))
    scheduler.costs.decode.observe(1, 0.04)
    assert len(_ids(scheduler)) < before


def test_nobody_makes_room_for_a_job_that_is_late_whatever_is_done() -> None:
    late = _job(1, HERO, deadline=0.01)
    scheduler = _scheduler(64, late, *[_job(n, CROWD) for n in range(2, 65)], costs=_costs())
    chosen = _ids(scheduler)
    assert chosen[0] == 1
    assert len(chosen) == 64


def test_steps_are_not_made_so_small_that_they_waste_the_machine() -> None:
    # The tight job alone would make it with 0.011 s a step; ten rows cost hardly more, one row wastes nine tenths.
    scheduler = _scheduler(64, _job(1, HERO, 0.046), *[_job(n, CROWD) for n in range(2, 65)], costs=_costs())
    assert len(_ids(scheduler)) >= 7


def test_with_a_backlog_there_is_nothing_to_waste() -> None:
    # 63 windows of 4 steps take 0.3 s at the least: with a second the hero gets small steps, with half of it not.
    for due, smaller in ((1.0, True), (0.5, False)):
        crowd = [_job(n, CROWD, due) for n in range(2, 65)]
        chosen = _ids(_scheduler(64, _job(1, HERO, 0.12), *crowd, costs=_costs()))
        assert chosen[0] == 1
        assert (len(chosen) <= 20) is smaller


def test_steps_are_held_to_a_length_that_a_backlog_stretches() -> None:
    # 0.03 s are 20 rows, twice that 50; the greatest buckets within are 16 and 48
    for due, rows in ((LATER, 16), (0.3, 48)):
        scheduler = Scheduler(_costs(), 64, max_step_s=0.03)
        for number in range(64):
            scheduler.add(_job(number, CROWD, due), 1)
        assert len(_ids(scheduler)) == rows


# ---- shares ----------------------------------------------------------------------------------------------------------


def _rows_by_class(scheduler: Scheduler, num_steps: int) -> Counter[Priority]:
    rows: Counter[Priority] = Counter()
    for _ in range(num_steps):
        rows.update(held.job.priority for held in scheduler.schedule(0.0))
    return rows


def test_each_class_gets_its_share_and_the_rest_goes_by_priority() -> None:
    jobs = [_job(100 * priority + n, priority) for priority in Priority for n in range(50)]
    rows = _rows_by_class(_scheduler(20, *jobs), 100)
    assert sum(rows.values()) == 2000
    for priority, share in zip((NEAR, CROWD, BATCH), DEFAULT_SHARES[1:], strict=True):
        assert rows[priority] == pytest.approx(2000 * share, abs=20)


def test_a_class_that_is_alone_gets_everything() -> None:
    assert _rows_by_class(_scheduler(4, *[_job(n, BATCH) for n in range(9)]), 10) == {BATCH: 40}


def test_what_a_class_did_not_ask_for_is_not_kept_for_later() -> None:
    scheduler = _scheduler(4, *[_job(n, HERO) for n in range(9)], _job(99, BATCH, 1.0))
    _rows_by_class(scheduler, 1000)
    scheduler.remove(99)
    _rows_by_class(scheduler, 1000)
    for n in range(100, 120):
        scheduler.add(_job(n, BATCH), 1)
    assert _rows_by_class(scheduler, 5)[BATCH] <= 3


@given(st.integers(1, 40), st.lists(st.sampled_from([HERO, NEAR, CROWD]), min_size=1, max_size=60))
def test_no_class_waits_longer_than_its_share_says(max_rows: int, others: list[Priority]) -> None:
    """The bound: a class with jobs left over gets a row within 1 / (share * rows) steps, and one for rounding."""
    jobs = [_job(n, priority, deadline=0.0) for n, priority in enumerate(others)]
    scheduler = _scheduler(max_rows, *jobs, _job(999, BATCH, deadline=5.0), _job(1000, BATCH, deadline=6.0))
    waited = longest = 0
    for _ in range(200):
        batch = scheduler.schedule(0.0)
        waited = 0 if any(held.job.priority is BATCH for held in batch) else waited + 1
        longest = max(longest, waited)
    rows = min(max_rows, len(jobs) + 2)
    # Each of the three classes below the first may have to wait for the others' whole rows, where a step has few.
    assert longest <= 1 / (DEFAULT_SHARES[3] * rows) + 4


# ---- books -----------------------------------------------------------------------------------------------------------

JOBS = st.lists(st.tuples(st.sampled_from(Priority), st.floats(0, 100)), min_size=1, max_size=40)


@given(JOBS, st.integers(1, 16), st.floats(0, 50))
def test_a_step_takes_each_class_from_its_earliest_on(
    jobs: list[tuple[Priority, float]], max_rows: int, now: float
) -> None:
    held = [_job(n, priority, deadline) for n, (priority, deadline) in enumerate(jobs)]
    scheduler = _scheduler(max_rows, *held, costs=_costs())
    for _ in range(5):
        batch = scheduler.schedule(now)
        assert 1 <= len(batch) <= max_rows
        assert [job.job.priority for job in batch] == sorted(job.job.priority for job in batch)
        for priority in Priority:
            due = sorted((job.deadline, job.job_id) for job in held if job.priority is priority)
            taken = [chosen.dueness for chosen in batch if chosen.job.priority is priority]
            assert taken == due[: len(taken)]


@given(JOBS, st.integers(1, 8))
def test_every_job_is_finished_after_all_its_steps_and_not_before(
    jobs: list[tuple[Priority, float]], max_rows: int
) -> None:
    scheduler = _scheduler(max_rows, *[_job(n, *job, num_steps=1 + n % 3) for n, job in enumerate(jobs)])
    steps: dict[int, int] = {}
    finished: list[int] = []
    for _ in range(3 * len(jobs)):
        batch = _ids(scheduler)
        for job_id in batch:
            steps[job_id] = steps.get(job_id, 0) + 1
        for job_id in scheduler.commit([RowStatus(job_id, steps[job_id], True) for job_id in batch]):
            assert steps[job_id] == 1 + job_id % 3
            scheduler.remove(job_id)
            finished.append(job_id)
    assert sorted(finished) == list(range(len(jobs)))
    assert len(scheduler) == 0


# ---- predictions -----------------------------------------------------------------------------------------------------


def test_the_prediction_counts_who_goes_before() -> None:
    scheduler = Scheduler(CostTable.assumed(0.01), 4, max_evaluations=4)
    assert scheduler.predict_s(NEAR, 1.0, 4, 1) == pytest.approx(0.04)
    for n in range(7):
        scheduler.add(_job(n, NEAR, 1.0), 1)
    assert scheduler.predict_s(NEAR, 2.0, 4, 1) == pytest.approx(0.08)
    assert scheduler.predict_s(NEAR, 0.5, 4, 1) == pytest.approx(0.04)
    assert scheduler.predict_s(HERO, 2.0, 4, 1) == pytest.approx(0.04)
    assert scheduler.predict_s(CROWD, 0.5, 4, 1) == pytest.approx(0.08)
    for n in range(7):
        scheduler.remove(n)
    assert scheduler.predict_s(NEAR, 2.0, 4, 1) == pytest.approx(0.04)


def test_the_prediction_counts_evaluations_not_rows() -> None:
    scheduler = Scheduler(_costs(), 64)
    scheduler.add(_job(1, NEAR, 1.0), 3)
    assert scheduler.predict_s(NEAR, 2.0, 4, 3) == pytest.approx(4 * 0.016)
