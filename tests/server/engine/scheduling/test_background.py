"""Windows in the background beside those of sessions of class BATCH, which is the class of clips: behind them."""

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
    """Of a clip that was due long ago, which its deadline says for ever."""
    return replace(window_job(job_id, BATCH, deadline), background=True)


@pytest.mark.parametrize("deadline", [-5.0, LATER + 1.0])
@pytest.mark.parametrize("begun", [True, False])
def test_a_clip_that_does_not_fit_keeps_no_session_of_its_class_from_its_step(begun: bool, deadline: float) -> None:
    # A row takes 10 ms, and a clip may make a step of three a fifth longer.
    scheduler = scheduler_of(
        8, *HEROES, _clip(deadline=deadline), window_job(SESSION, BATCH), costs=step_costs(0.0, 0.01)
    )
    if begun:
        scheduler.mark_prepared([CLIP])
    assert next_ids(scheduler) == [0, 1, 2, SESSION]


def test_a_session_does_not_wait_for_a_clip_to_be_done_and_clips_wait_for_one_another() -> None:
    scheduler = scheduler_of(8, _clip(), _clip(CLIP + 1), costs=step_costs(0.01, 0.0))
    scheduler.mark_prepared([CLIP])
    assert next_ids(scheduler) == [CLIP]
    scheduler.add(window_job(SESSION, BATCH), 1)
    assert SESSION in next_ids(scheduler)


def test_where_there_is_more_to_do_than_can_be_done_sessions_and_clips_each_get_the_share_of_their_class() -> None:
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


def test_clips_alone_get_all_that_a_step_in_the_background_may_take() -> None:
    scheduler = scheduler_of(8, *[_clip(CLIP + number) for number in range(9)], costs=CostTable.assumed(0.001))
    assert len(next_ids(scheduler)) == 8
