"""Background windows, which are those of clips, rank behind windows of sessions of the same class, BATCH."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.scheduler import DEFAULT_SHARES
from motiongen_server.engine.types import WindowJob
from tests.server.engine.scheduling.scheduled import (
    BATCH,
    HERO,
    LATER,
    next_ids,
    scheduler_of,
    step_costs,
    window_job,
)

HEROES = [window_job(number, HERO) for number in range(3)]
SESSION, CLIP = 50, 90


def _clip(job_id: int = CLIP, deadline: float = -5.0) -> WindowJob:
    """A window of a clip that is overdue, as a clip's deadline always says."""
    return replace(window_job(job_id, BATCH, deadline), background=True)


@pytest.mark.parametrize("deadline", [-5.0, LATER + 1.0])
@pytest.mark.parametrize("begun", [True, False])
def test_clip_that_does_not_fit_keeps_no_batch_session_out_of_a_step(begun: bool, deadline: float) -> None:
    # A row takes 10 ms, and a clip may make a step of three a fifth longer.
    scheduler = scheduler_of(
        8, *HEROES, _clip(deadline=deadline), window_job(SESSION, BATCH), costs=step_costs(0.0, 0.01)
    )
    if begun:
        scheduler.mark_prepared([CLIP])
    assert next_ids(scheduler) == [0, 1, 2, SESSION]


def test_sessions_do_not_wait_for_running_clips_but_other_clips_do() -> None:
    scheduler = scheduler_of(8, _clip(), _clip(CLIP + 1), costs=step_costs(0.01, 0.0))
    scheduler.mark_prepared([CLIP])
    assert next_ids(scheduler) == [CLIP]
    scheduler.add(window_job(SESSION, BATCH), 1)
    assert SESSION in next_ids(scheduler)


def test_under_overload_sessions_and_clips_each_get_the_share_of_their_class() -> None:
    heroes = [window_job(number, HERO) for number in range(40)]
    sessions = [window_job(SESSION + number, BATCH) for number in range(30)]
    scheduler = scheduler_of(20, *heroes, *sessions, *[_clip(CLIP + number) for number in range(30)])
    scheduler.mark_prepared([CLIP])
    rows: Counter[str] = Counter()
    for _ in range(100):
        rows.update(
            "hero" if job_id < SESSION else "session" if job_id < CLIP else "clip" for job_id in next_ids(scheduler)
        )
    assert rows["session"] == pytest.approx(2000 * DEFAULT_SHARES[BATCH - 1], abs=20)
    assert rows["clip"] == pytest.approx(2000 * DEFAULT_SHARES[BATCH - 1], abs=20)


def test_clips_alone_get_all_rows_of_a_step() -> None:
    scheduler = scheduler_of(8, *[_clip(CLIP + number) for number in range(9)], costs=CostTable.assumed(0.001))
    assert len(next_ids(scheduler)) == 8
