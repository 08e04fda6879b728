"""The baseline scheduling policies, by themselves and in the engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.policy import SchedulingPolicy
from motiongen_server.engine.scheduling.scheduled_job import ScheduledJob
from motiongen_server.engine.types import (
    Chunk,
    Guidance,
    Open,
    Output,
    Priority,
    RowStatus,
    SessionKey,
    SessionSpec,
    WindowJob,
)
from tests.bench.null_runner import FACTS, NullRunner
from tests.bench.offline import first_job
from tests.bench.policies import OneAtATime, StepsInOrder, WholeWindows

EMBEDDINGS = [np.zeros(FACTS.embedding_dim, np.float32)]


def make_job(job_id: int, *, num_steps: int = 3, created_at: float = 0.0) -> WindowJob:
    return replace(first_job(job_id, num_steps, EMBEDDINGS), job_id=job_id, created_at=created_at)


def step(policy: SchedulingPolicy, now: float = 0.0) -> list[int]:
    """Run one step of what is scheduled, and remove finished jobs. Returns the ids of the jobs in the step."""
    held: list[ScheduledJob] = list(policy.schedule(now))
    statuses = [RowStatus(each.job.job_id, each.steps_done + 1, finite=True) for each in held]
    for job_id in policy.commit(statuses):
        policy.remove(job_id)
    return [each.job.job_id for each in held]


def costs() -> CostTable:
    return CostTable.assumed(0.01)


def test_one_at_a_time_finishes_a_window_before_the_next() -> None:
    policy = OneAtATime(costs())
    for job_id in (1, 2):
        policy.add(make_job(job_id), 3)
    assert [step(policy) for _ in range(7)] == [[1], [1], [1], [2], [2], [2], []]


def test_steps_in_order_take_the_oldest_jobs_and_refill_rows_that_end() -> None:
    policy = StepsInOrder(costs(), max_rows=2)
    for job_id, num_steps in ((1, 2), (2, 4), (3, 2), (4, 1)):
        policy.add(make_job(job_id, num_steps=num_steps), 3)
    assert [step(policy) for _ in range(6)] == [[1, 2], [1, 2], [2, 3], [2, 3], [4], []]


def whole_windows(max_rows: int = 3) -> WholeWindows:
    return WholeWindows(costs(), max_rows, shape_of=lambda job: job.num_steps, wait_s=0.02)


def test_whole_windows_wait_briefly_and_then_take_jobs_of_one_shape() -> None:
    policy = whole_windows()
    policy.add(make_job(1, created_at=5.0), 3)
    policy.add(make_job(2, created_at=5.01, num_steps=2), 3)
    policy.add(make_job(3, created_at=5.01), 3)
    assert step(policy, 5.019) == []
    assert policy.wake_at() == pytest.approx(5.02)
    assert step(policy, 5.021) == [1, 3]


def test_running_whole_windows_take_no_more_jobs_and_full_batches_do_not_wait() -> None:
    policy = whole_windows(max_rows=2)
    policy.add(make_job(1), 3)
    policy.add(make_job(2), 3)
    assert step(policy) == [1, 2]
    policy.add(make_job(3), 3)
    policy.remove(2)
    assert [step(policy, 9.0) for _ in range(3)] == [[1], [1], [3]]


@pytest.mark.parametrize(
    ("policy", "most_rows"),
    [(OneAtATime(costs()), 1), (StepsInOrder(costs(), max_rows=3), 3), (whole_windows(), 3)],
    ids=lambda value: type(value).__name__,
)
def test_engine_with_this_policy_serves_every_session(policy: SchedulingPolicy, most_rows: int) -> None:
    class Clock:
        seconds = 0.0

        def now(self) -> float:
            return self.seconds

    clock, sent = Clock(), list[Output]()
    engine = Engine(NullRunner(), clock, sent.extend, EngineConfig(), scheduler=policy)
    for handle in range(7):
        spec = SessionSpec(SessionKey(1, handle), handle, "null", Priority.NEAR, 40, 3, Guidance(2.0, 2.0))
        engine.submit(Open(spec, 1, 0.0))
    rows = []
    for _ in range(40):
        rows.append(engine.step().rows)
        clock.seconds += 0.01
    assert max(rows) == most_rows
    assert {output.session.handle for output in sent if isinstance(output, Chunk)} == set(range(7))
    assert policy.predict_s(Priority.NEAR, 1.0, 3, 3) > 0
