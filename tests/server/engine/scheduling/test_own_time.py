"""An engine's own time, between calls of the runner, is counted per window; idle time is not."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
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
from motiongen_server.engine.types import Chunk, Float32Array, Output, Priority, RowStatus
from motiongen_server.engine.types.report import StepReport
from tests.server.engine.fakes import FACTS, FakeClock, FakeRunner
from tests.server.engine.stage import Stage

BETWEEN_S, IDLE_S, TURN_S = 0.25, 60.0, 5.0


class Shared(Device):
    """A device every turn of which has to be waited for."""

    def __init__(self, clock: FakeClock) -> None:
        super().__init__()
        self._clock = clock

    def take(self) -> float:
        super().take()
        self._clock.advance(TURN_S)
        return TURN_S


class Played:
    """A step executor and its costs, with methods that run windows through it."""

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

    def play(self, clock: FakeClock, number: int, *, background: bool = False, between_s: float = BETWEEN_S) -> None:
        """Run a window from beginning to end, with between_s after each of its steps."""
        self.add(number, background=background)
        finished: list[int] = []
        while not finished:
            _, finished = self.step()
            clock.advance(between_s)
        self.decode(finished)


@pytest.mark.parametrize("device", [lambda clock: Device(), Shared])
def test_own_time_is_what_passes_between_calls_while_there_is_work(device: Callable[[FakeClock], Device]) -> None:
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


def test_idle_time_after_a_failed_step_is_not_own_time() -> None:
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


def test_own_time_is_part_of_price_and_use_if_the_device_counts_it() -> None:
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


def test_own_time_of_background_windows_does_not_count_as_use() -> None:
    clock = FakeClock()
    played = Played(clock, FakeRunner(clock), Device(counts_own=True))
    played.play(clock, 0, background=True)
    assert played.costs.own_each_s > 0.0
    assert played.executor.use == DeviceUse()


def test_one_wave_of_slow_windows_does_not_determine_own_time() -> None:
    """Of each thousand windows, a wave of 250 takes as long as the other 750 together."""
    clock = FakeClock()
    played = Played(clock, FakeRunner(clock, step_s=lambda rows: 0.0), Device(counts_own=True))
    played.costs.begin_own(0.001)
    found = []
    for number in range(4000):
        is_dear = number % 1000 < 250
        played.play(clock, number, between_s=0.001 if is_dear else 0.00033)
        found.append(played.costs.own_each_s)
    assert 0.0008 < min(found[1000:]) <= max(found[1000:]) < 0.0014
    assert np.mean(found[1000:]) == pytest.approx(0.001, rel=0.1)


def test_single_stall_of_an_engine_hardly_changes_own_time() -> None:
    costs = CostTable.assumed(0.01)
    costs.begin_own(0.0003)
    for _ in range(64):
        costs.observe_own(4, 4 * 0.0003, 0.01)
    costs.observe_own(4, 5.0, 5.0)
    assert costs.own_each_s < 0.0004
    for _ in range(64):
        costs.observe_own(4, 4 * 0.0003, 0.01)
    assert costs.own_each_s == pytest.approx(0.0003, rel=0.2)


def test_initial_measurement_gives_way_to_the_first_windows_of_sessions() -> None:
    costs = CostTable.assumed(0.01)
    costs.begin_own(0.0003)
    for _ in range(8):
        costs.observe_own(32, 32 * 0.0009, 0.03)
    assert costs.own_each_s > 0.0008


def test_own_time_follows_a_lasting_change() -> None:
    costs = CostTable.assumed(0.01)
    costs.begin_own(0.0003)
    for each_s in (0.003, 0.0006):
        for _ in range(300):
            costs.observe_own(4, 4 * each_s, 0.01)
        assert costs.own_each_s == pytest.approx(each_s, rel=0.4)


def test_own_time_of_uneven_windows_is_their_average() -> None:
    costs = CostTable.assumed(0.01)
    costs.begin_own(0.001)
    found = []
    for number in range(2000):
        costs.observe_own(1, 0.008 if number % 8 == 0 else 0.0, 0.001)
        found.append(costs.own_each_s)
    assert np.mean(found) == pytest.approx(0.001, rel=0.05)


def test_stall_of_the_engine_does_not_count_as_load() -> None:
    """Beside a GPU, an engine takes 2 ms for each chunk of a hundred characters, and stalls once for 4 s."""
    stage = Stage(EngineConfig(), lease=Device(counts_own=True).lease())
    stage.runner.step_s = lambda rows: 0.001
    deliver = stage.deliver

    def take_a_while(outputs: Sequence[Output]) -> None:
        stage.clock.advance(0.002 * sum(isinstance(output, Chunk) for output in outputs))
        deliver(outputs)

    stage.deliver = take_a_while  # type: ignore[method-assign]
    for handle in range(1, 101):
        stage.open(handle, seed=handle, priority=Priority.NEAR)
    stage.run(10.0)
    while not (stage.step().rows and len(stage.engine.windows)):
        stage.run(0.001)
    before = len(stage.reports)
    stage.clock.advance(4.0)
    stage.run(3.0)
    loads = [
        [report.load for report in part if report.load is not None]
        for part in (stage.reports[:before], stage.reports[before:])
    ]
    assert [max(load) < 0.3 for load in loads] == [True, True], loads


def rounds() -> Callable[[], float]:
    """A clock of processor time that advances by a millisecond each time it is read."""
    used = itertools.count()
    return lambda: 0.001 * next(used)


@pytest.mark.parametrize(
    ("fps", "horizon", "steps", "rows"),
    [
        (20, 40, 4, 64),
        (30, 32, 4, 64),
        (60, 64, 4, 64),
        (10, 96, 4, 64),
        (20, 40, 50, 64),
        (20, 40, 1000, 8),
        (20, 40, 4, 1),
    ],
)
def test_own_time_is_measured_before_any_session_opens(fps: int, horizon: int, steps: int, rows: int) -> None:
    """For any number of steps of a window and any number of rows of a step."""
    facts = replace(FACTS, fps=fps, horizon=horizon, default_steps=steps, max_steps=1000)
    own_s = own_time_s(facts, EngineConfig(max_rows=rows), rounds())
    # 192 characters need a window each time that one has been played; rounds are a twentieth of a second apart.
    assert own_s == pytest.approx(0.001 * 20 / (192 * fps / horizon), rel=0.3)
