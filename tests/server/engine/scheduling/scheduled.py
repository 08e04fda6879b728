"""Window jobs, schedulers that hold them, and the jobs of the next step."""

from __future__ import annotations

import numpy as np

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.types import Guidance, PlanCause, Priority, SessionKey, WindowJob

HERO, NEAR, CROWD, BATCH = Priority
LATER = 1000.0


def window_job(job_id: int, priority: Priority, deadline: float = LATER, num_steps: int = 4) -> WindowJob:
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


def step_costs(fixed_s: float = 0.01, each_s: float = 0.001) -> CostTable:
    """A step of e evaluations costs fixed_s + e * each_s; other calls cost nothing."""
    costs = CostTable.assumed(fixed_s)
    for size in (1, 2, 4, 8, 16, 32, 64, 128):
        costs.step.observe(size, fixed_s + each_s * size)
    return costs


def scheduler_of(max_rows: int, *jobs: WindowJob, passes: int = 1, costs: CostTable | None = None) -> Scheduler:
    scheduler = Scheduler(costs or CostTable.assumed(0.02), max_rows)
    for job in jobs:
        scheduler.add(job, passes)
    return scheduler


def next_ids(scheduler: Scheduler, now: float = 0.0) -> list[int]:
    return [held.job.job_id for held in scheduler.schedule(now)]
