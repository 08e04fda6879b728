"""Which share of the rows of denoising steps each class of sessions gets, and that no window is lost."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.scheduling.scheduler import DEFAULT_SHARES, Scheduler
from motiongen_server.engine.types import Priority, RowStatus
from tests.server.engine.scheduling.scheduled import (
    BATCH,
    CROWD,
    HERO,
    NEAR,
    next_ids,
    scheduler_of,
    step_costs,
    window_job,
)

# ---- shares ----------------------------------------------------------------------------------------------------------


def _rows_by_class(scheduler: Scheduler, num_steps: int) -> Counter[Priority]:
    rows: Counter[Priority] = Counter()
    for _ in range(num_steps):
        rows.update(held.job.priority for held in scheduler.schedule(0.0))
    return rows


def test_each_class_gets_its_share_and_the_rest_goes_by_priority() -> None:
    jobs = [window_job(100 * priority + n, priority) for priority in Priority for n in range(50)]
    rows = _rows_by_class(scheduler_of(20, *jobs), 100)
    assert sum(rows.values()) == 2000
    for priority, share in zip((NEAR, CROWD, BATCH), DEFAULT_SHARES[1:], strict=True):
        assert rows[priority] == pytest.approx(2000 * share, abs=20)


def test_class_without_competitors_gets_every_row() -> None:
    assert _rows_by_class(scheduler_of(4, *[window_job(n, BATCH) for n in range(9)]), 10) == {BATCH: 40}


def test_unused_share_of_a_class_is_not_saved_up() -> None:
    scheduler = scheduler_of(4, *[window_job(n, HERO) for n in range(9)], window_job(99, BATCH, 1.0))
    _rows_by_class(scheduler, 1000)
    scheduler.remove(99)
    _rows_by_class(scheduler, 1000)
    for n in range(100, 120):
        scheduler.add(window_job(n, BATCH), 1)
    assert _rows_by_class(scheduler, 5)[BATCH] <= 3


@given(st.integers(1, 40), st.lists(st.sampled_from([HERO, NEAR, CROWD]), min_size=1, max_size=60))
def test_least_urgent_class_waits_no_longer_than_its_share_allows(max_rows: int, others: list[Priority]) -> None:
    """The bound: a class with jobs left over gets a row within 1 / (share * rows) steps, and one for rounding."""
    jobs = [window_job(n, priority, deadline=0.0) for n, priority in enumerate(others)]
    scheduler = scheduler_of(
        max_rows, *jobs, window_job(999, BATCH, deadline=5.0), window_job(1000, BATCH, deadline=6.0)
    )
    waited = longest = 0
    for _ in range(200):
        batch = scheduler.schedule(0.0)
        waited = 0 if any(held.job.priority is BATCH for held in batch) else waited + 1
        longest = max(longest, waited)
    rows = min(max_rows, len(jobs) + 2)
    # Each of the three classes below the first may have to wait for the others' whole rows, where a step has few.
    assert longest <= 1 / (DEFAULT_SHARES[3] * rows) + 4


# ---- no window is lost -----------------------------------------------------------------------------------------------


JOBS = st.lists(st.tuples(st.sampled_from(Priority), st.floats(0, 100)), min_size=1, max_size=40)


@given(JOBS, st.integers(1, 16), st.floats(0, 50))
def test_step_takes_the_earliest_due_jobs_of_each_class(
    jobs: list[tuple[Priority, float]], max_rows: int, now: float
) -> None:
    held = [window_job(n, priority, deadline) for n, (priority, deadline) in enumerate(jobs)]
    scheduler = scheduler_of(max_rows, *held, costs=step_costs())
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
    scheduler = scheduler_of(max_rows, *[window_job(n, *job, num_steps=1 + n % 3) for n, job in enumerate(jobs)])
    steps: dict[int, int] = {}
    finished: list[int] = []
    for _ in range(3 * len(jobs)):
        batch = next_ids(scheduler)
        for job_id in batch:
            steps[job_id] = steps.get(job_id, 0) + 1
        for job_id in scheduler.commit([RowStatus(job_id, steps[job_id], True) for job_id in batch]):
            assert steps[job_id] == 1 + job_id % 3
            scheduler.remove(job_id)
            finished.append(job_id)
    assert sorted(finished) == list(range(len(jobs)))
    assert len(scheduler) == 0
