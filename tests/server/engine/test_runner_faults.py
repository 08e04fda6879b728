"""Failures of the runner close the session whose window fails, and no other."""

from collections.abc import Sequence

import pytest

from motiongen_server.engine.types import (
    CloseReason,
    Code,
)
from tests.server.engine.stage import crowd, prompt


@pytest.mark.parametrize("call", ["prepare", "denoise", "decode"])
def test_job_that_makes_the_runner_raise_closes_only_its_session(call: str) -> None:
    stage, viewers = crowd(5)
    stage.run(0.5)
    bad = stage.open(66, seed=666)

    def fails(called: str, job_ids: Sequence[int]) -> bool:
        owners = stage.engine.windows.owners
        return called == call and any(owners[job_id].key == bad.key for job_id in job_ids)

    stage.runner.fails = fails
    stage.run(10.0)
    assert bad.closed is not None
    assert (bad.closed.reason, bad.closed.code) == (CloseReason.ENGINE_FAULT, Code.INTERNAL)
    assert bad.rows == []
    assert stage.total("runner_faults") >= 1
    for viewer in viewers:
        assert viewer.closed is None
        assert viewer.underruns == 0
    assert stage.engine.windows.owners.keys() == stage.runner.jobs.keys()
    stage.check_finished()


@pytest.mark.parametrize("call", ["prepare", "denoise", "decode"])
def test_runner_fault_that_occurs_once_closes_no_session(call: str) -> None:
    stage, viewers = crowd(5)
    faults = iter([True])
    stage.runner.fails = lambda called, job_ids: called == call and next(faults, False)
    stage.run(5.0)
    assert stage.total("runner_faults") == 1
    assert all(viewer.closed is None and viewer.underruns == 0 for viewer in viewers)
    stage.check_finished()


@pytest.mark.parametrize("hook", ["poisoned", "poisoned_result"])
def test_numbers_that_are_not_finite_close_only_their_session(hook: str) -> None:
    stage, viewers = crowd(5)
    setattr(stage.runner, hook, lambda job: job.session == viewers[2].key and job.plan == 2)
    seq = stage.set_prompts(viewers[2], prompt(4))
    stage.run(10.0)
    closed = viewers[2].closed
    assert closed is not None
    assert closed.reason is CloseReason.ENGINE_FAULT
    assert "finite" in closed.message
    assert stage.total("nan_rows") == 1
    assert seq in viewers[2].outcomes
    others = viewers[:2] + viewers[3:]
    assert all(viewer.closed is None and viewer.underruns == 0 for viewer in others)
    stage.check_finished()


def test_a_session_that_failed_can_be_opened_again() -> None:
    stage, (viewer,) = crowd(1)
    stage.runner.poisoned = lambda job: True
    stage.run(0.5)
    assert viewer.closed is not None
    stage.runner.poisoned = lambda job: False
    again = stage.open(1)
    stage.run(1.0)
    assert again.buffered_to >= 40
