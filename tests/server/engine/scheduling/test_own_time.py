"""What an engine takes itself, between calls of the runner, is counted by window, and idling is not."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.scheduling.step_executor import StepExecutor
from motiongen_server.engine.scheduling.trial_jobs import trial_job
from motiongen_server.engine.types import Float32Array
from motiongen_server.engine.types.report import StepReport
from tests.server.engine.fakes import FakeClock, FakeRunner

BETWEEN_S, IDLE_S = 0.25, 60.0


def test_it_is_what_passes_between_calls_while_there_is_work() -> None:
    clock = FakeClock()
    runner, costs = FakeRunner(clock), CostTable.assumed(0.01)
    executor = StepExecutor(
        runner,
        Scheduler(costs, 8),
        clock,
        8,
        failed=lambda job_id, message: pytest.fail(message),
        begins=lambda job_id, left_s: None,
        lease=Device().lease(),
    )
    nothing: Float32Array = np.zeros((0, runner.facts.feature_dim), np.float32)
    for number in range(2):
        job = trial_job(runner.facts, number, nothing, is_steered=False)
        executor.add(job)
        finished: list[int] = []
        between_s = 0.0
        while not finished:
            _, finished = executor.step(StepReport())
            clock.advance(BETWEEN_S)
            between_s += BETWEEN_S
        before = costs.own_each_s
        executor.decode(finished, StepReport())
        executor.finish(number)
        assert costs.own_each_s == pytest.approx(before + (between_s - before) / 128)
        clock.advance(IDLE_S)
        assert executor.step(StepReport()) == ([], [])
