"""What an engine takes itself, between calls of the runner, is counted by window, and idling is not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.scheduling.step_executor import StepExecutor
from motiongen_server.engine.scheduling.trial_jobs import trial_job
from motiongen_server.engine.types import Float32Array, RowStatus
from motiongen_server.engine.types.report import StepReport
from tests.server.engine.fakes import FakeClock, FakeRunner

BETWEEN_S, IDLE_S, TURN_S = 0.25, 60.0, 5.0


class Shared(Device):
    """Whose every turn is waited for."""

    def __init__(self, clock: FakeClock) -> None:
        super().__init__()
        self._clock = clock

    def take(self) -> float:
        super().take()
        self._clock.advance(TURN_S)
        return TURN_S


class Played:
    """An executor, and what goes through it."""

    def __init__(self, clock: FakeClock, runner: FakeRunner, device: Device) -> None:
        self.costs, self._facts, self.lease = CostTable.assumed(0.01), runner.facts, device.lease()
        policy = Scheduler(self.costs, 8)
        self.executor = StepExecutor(
            runner, policy, clock, 8, failed=self._drop, begins=lambda job_id, left_s: None, lease=self.lease
        )

    def _drop(self, job_id: int, message: str) -> None:
        del message
        self.executor.discard(job_id)

    def add(self, number: int) -> None:
        history: Float32Array = np.zeros((0, self._facts.feature_dim), np.float32)
        self.executor.add(trial_job(self._facts, number, history, is_steered=False))

    def step(self) -> tuple[list[RowStatus], list[int]]:
        with self.lease:
            return self.executor.step(StepReport())

    def decode(self, finished: list[int]) -> None:
        with self.lease:
            self.executor.decode(finished, StepReport())
        for number in finished:
            self.executor.finish(number)


@pytest.mark.parametrize("device", [lambda clock: Device(), Shared])
def test_it_is_what_passes_between_calls_while_there_is_work(device: Callable[[FakeClock], Device]) -> None:
    clock = FakeClock()
    played = Played(clock, FakeRunner(clock), device(clock))
    for number in range(2):
        played.add(number)
        finished: list[int] = []
        between_s = 0.0
        while not finished:
            _, finished = played.step()
            clock.advance(BETWEEN_S)
            between_s += BETWEEN_S
        before = played.costs.own_each_s
        played.decode(finished)
        assert played.costs.own_each_s == pytest.approx(before + (between_s - before) / 128)
        clock.advance(IDLE_S)
        assert played.step() == ([], [])


def test_idling_after_a_step_of_which_nothing_came_is_not_either() -> None:
    clock = FakeClock()
    played = Played(clock, FakeRunner(clock, fails=lambda call, job_ids: 0 in job_ids), Device())
    played.add(0)
    assert played.step() == ([], [])
    clock.advance(IDLE_S)
    played.add(1)
    finished: list[int] = []
    while not finished:
        _, finished = played.step()
    before = played.costs.own_each_s
    played.decode(finished)
    assert played.costs.own_each_s == pytest.approx(before * (1 - 1 / 128))
