import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.engine.scheduler import CostTable, Scheduler
from server.engine.types import Guidance, PlanCause, Priority, RowStatus, SessionKey, WindowJob

HERO, NEAR, CROWD, BATCH = Priority


def _job(job_id: int, priority: Priority, deadline: float, num_steps: int = 4) -> WindowJob:
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


def _ids(scheduler: Scheduler) -> list[int]:
    return [held.job.job_id for held in scheduler.schedule()]


def _scheduler(max_rows: int, *jobs: WindowJob) -> Scheduler:
    scheduler = Scheduler(max_rows, 0.02)
    for job in jobs:
        scheduler.add(job)
    return scheduler


def test_the_earliest_deadline_goes_first_within_a_class() -> None:
    scheduler = _scheduler(8, _job(1, NEAR, 3.0), _job(2, NEAR, 1.0), _job(3, HERO, 9.0), _job(4, NEAR, 2.0))
    assert _ids(scheduler) == [3, 2, 4, 1]


def test_one_row_of_a_full_step_goes_to_the_earliest_deadline_of_any_class() -> None:
    jobs = [_job(n, HERO, 10.0 + n) for n in range(1, 5)]
    scheduler = _scheduler(3, *jobs, _job(9, BATCH, 1.0), _job(8, CROWD, 2.0))
    assert _ids(scheduler) == [1, 2, 9]


def test_a_single_row_goes_by_class() -> None:
    assert _ids(_scheduler(1, _job(1, BATCH, 0.0), _job(2, HERO, 5.0))) == [2]


JOBS = st.lists(st.tuples(st.sampled_from(Priority), st.floats(0, 100)), min_size=1, max_size=40)


@given(JOBS, st.integers(1, 16))
def test_a_step_is_the_head_of_the_queue_and_one_of_the_earliest(
    jobs: list[tuple[Priority, float]], max_rows: int
) -> None:
    held = [_job(n, priority, deadline) for n, (priority, deadline) in enumerate(jobs)]
    ids = _ids(_scheduler(max_rows, *held))
    by_class = [job.job_id for job in sorted(held, key=lambda job: (job.priority, job.deadline, job.job_id))]
    assert len(ids) == len(set(ids)) == min(max_rows, len(held))
    if max_rows >= len(held) or max_rows == 1:
        assert ids == by_class[:max_rows]
    else:
        assert ids[:-1] == by_class[: max_rows - 1]
        assert min(held, key=lambda job: (job.deadline, job.job_id)).job_id in ids


@given(JOBS, st.integers(2, 8))
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


def test_buckets_are_powers_of_two() -> None:
    assert [CostTable.bucket(rows) for rows in (1, 2, 3, 8, 9)] == [1, 2, 4, 8, 16]


def test_costs_follow_what_is_measured() -> None:
    costs = CostTable(0.5)
    assert costs.window_s(4, 2) == 1.0
    for _ in range(100):
        costs.observe(4, 0.1)
    assert costs.window_s(3, 10) == pytest.approx(1.0)
    for _ in range(100):
        costs.observe(4, 0.2)
    assert costs.window_s(4, 10) == pytest.approx(2.0, rel=1e-2)


def test_a_bucket_not_measured_is_judged_by_its_neighbours() -> None:
    costs = CostTable(0.5)
    costs.observe(8, 0.08)
    assert costs.window_s(2, 1) == pytest.approx(0.08)
    assert costs.window_s(32, 1) == pytest.approx(0.32)


def test_unsteady_costs_are_predicted_with_room() -> None:
    costs = CostTable(0.5)
    for n in range(200):
        costs.observe(1, 0.1 if n % 2 else 0.3)
    assert costs.window_s(1, 1) > 0.3


def test_the_prediction_counts_who_goes_before() -> None:
    scheduler = Scheduler(4, 0.01)
    scheduler.costs.observe(4, 0.01)
    assert scheduler.predict_s(NEAR, 4) == pytest.approx(0.04)
    for n in range(7):
        scheduler.add(_job(n, NEAR, 1.0))
    assert scheduler.predict_s(NEAR, 4) == pytest.approx(0.08)
    assert scheduler.predict_s(HERO, 4) == pytest.approx(0.04)
    for n in range(7):
        scheduler.remove(n)
    assert scheduler.predict_s(NEAR, 4) == pytest.approx(0.04)
