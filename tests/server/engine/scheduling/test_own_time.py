"""What an engine takes itself, between calls of the runner, is counted by window, and idling is not."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.own_time import own_time_s
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.device_use import DeviceUse
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.scheduling.step_executor import StepExecutor
from motiongen_server.engine.scheduling.trial_jobs import trial_job
from motiongen_server.engine.types import Float32Array, RowStatus
from motiongen_server.engine.types.report import StepReport
from tests.server.engine.fakes import FACTS, FakeClock, FakeRunner

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

    def add(self, number: int, *, background: bool = False) -> None:
        history: Float32Array = np.zeros((0, self._facts.feature_dim), np.float32)
        job = trial_job(self._facts, number, history, is_steered=False)
        self.executor.add(replace(job, background=background))

    def step(self) -> tuple[list[RowStatus], list[int]]:
        with self.lease:
            return self.executor.step(StepReport())

    def decode(self, finished: list[int]) -> None:
        with self.lease:
            self.executor.decode(finished, StepReport())
        for number in finished:
            self.executor.finish(number)

    def play(self, clock: FakeClock, number: int, *, background: bool = False) -> None:
        """A window from its beginning to its end, after each of whose calls some time passes."""
        self.add(number, background=background)
        finished: list[int] = []
        while not finished:
            _, finished = self.step()
            clock.advance(BETWEEN_S)
        self.decode(finished)


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


def test_beside_another_device_it_is_part_of_what_a_window_takes_and_of_what_is_in_use() -> None:
    found = []
    for counts_own in (False, True):
        clock = FakeClock()
        played = Played(clock, FakeRunner(clock), Device(counts_own=counts_own))
        played.costs.own_each_s = 1.0
        played.play(clock, 0)
        found.append((played.executor.prices(), played.executor.use, played.costs.own_each_s))
    (price, use, own_s), (with_own, use_with_own, same_s) = found
    assert own_s == same_s > 0.0
    assert with_own.window_s - price.window_s == pytest.approx(own_s)
    assert with_own.step_s == price.step_s
    assert use_with_own.work_s - use.work_s == pytest.approx(own_s)
    assert use_with_own.busy_s - use.busy_s == pytest.approx(2 * BETWEEN_S)


def test_the_backgrounds_part_of_it_does_not_count_as_use() -> None:
    clock = FakeClock()
    played = Played(clock, FakeRunner(clock), Device(counts_own=True))
    played.play(clock, 0, background=True)
    assert played.costs.own_each_s > 0.0
    assert played.executor.use == DeviceUse()


def rounds() -> Callable[[], float]:
    """A processor of which each round takes a thousandth of a second."""
    used = itertools.count()
    return lambda: 0.001 * next(used)


@pytest.mark.parametrize(("fps", "horizon"), [(20, 40), (30, 32), (60, 64), (10, 96)])
def test_it_is_measured_before_anybody_comes(fps: int, horizon: int) -> None:
    own_s = own_time_s(replace(FACTS, fps=fps, horizon=horizon), EngineConfig(), rounds())
    # 192 characters need a window each time that one has been played; rounds are a twentieth of a second apart.
    assert own_s == pytest.approx(0.001 * 20 / (192 * fps / horizon), rel=0.3)
