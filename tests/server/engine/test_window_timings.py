"""If traces are asked for, the notice of a plan has the times of its window, in virtual time; otherwise none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import PlanCause, PlanNotice
from tests.server.engine.stage import Stage, prompt


def notices(config: EngineConfig) -> list[PlanNotice]:
    """The notices of a session that is opened and edited once, over six seconds."""
    stage = Stage(config)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(2.0)
    stage.set_prompts(viewer, prompt(2))
    stage.run(4.0)
    return [said for said in stage.outputs if isinstance(said, PlanNotice)]


def test_window_times_are_in_order_and_name_the_engine() -> None:
    made = notices(EngineConfig(trace_as="pid 7"))
    assert len(made) > 2
    for notice in made:
        timing = notice.timing
        assert timing is not None
        assert timing.asked_at <= timing.created_at <= timing.begun_at < timing.landed_at
        assert (timing.engine, timing.num_steps) == ("pid 7", 4)
    lands = [notice.timing.landed_at for notice in made if notice.timing]
    assert lands == sorted(lands)


def test_edit_is_timed_from_its_arrival() -> None:
    made = notices(EngineConfig(trace_as="pid 7"))
    (edit,) = [notice for notice in made if notice.cause is PlanCause.EDIT]
    (after,) = [notice for notice in made if notice.plan == edit.plan + 1]
    assert edit.timing is not None
    assert after.timing is not None
    assert edit.timing.asked_at == pytest.approx(made[0].timing.asked_at + 2.0, abs=0.1)  # type: ignore[union-attr]
    assert after.timing.asked_at == after.timing.created_at, "no event asked for it: it was due"


def test_plans_with_and_without_traces_differ_only_in_their_times() -> None:
    plain, traced = notices(EngineConfig()), notices(EngineConfig(trace_as="pid 7"))
    assert [notice.timing for notice in plain] == [None] * len(plain)
    assert [replace(notice, timing=None) for notice in traced] == plain


def test_discarded_windows_leave_no_timings_behind() -> None:
    stage = Stage(EngineConfig(trace_as="pid 7"))
    viewer = stage.open(prompts=(prompt(1),))
    for number in range(20):
        stage.run(0.15)
        stage.set_prompts(viewer, prompt(number))
    stage.close(viewer)
    stage.run(1.0)
    timings = stage.engine.windows.timings
    assert timings is not None
    assert len(timings) == 0
