import itertools
from collections.abc import Callable, Sequence

import pytest

from motiongen_server.engine.ports import OutOfMemory
from motiongen_server.engine.scheduling.profile import UnsoundModel, profile
from tests.server.engine.fakes import FACTS, FakeClock, FakeRunner


def _runner(fixed_s: float = 0.01, each_s: float = 0.001) -> FakeRunner:
    """A step of r rows costs fixed_s + r * each_s."""
    runner = FakeRunner(FakeClock())
    runner.step_s = lambda rows: fixed_s + each_s * rows
    return runner


def test_profile_measures_the_cost_of_steps_of_every_size() -> None:
    runner = _runner()
    measured = profile(runner, runner.clock, max_rows=24, history_frames=16)
    assert measured.max_rows == 24
    for rows in (1, 2, 4, 8, 16, 24):
        assert measured.costs.step.seconds(rows) == pytest.approx(0.01 + 0.001 * rows)
    assert measured.costs.decode.seconds(8) < 1e-6


def test_profiled_windows_resemble_those_of_sessions_and_leave_no_jobs() -> None:
    runner = _runner()
    profile(runner, runner.clock, max_rows=4, history_frames=16)
    assert runner.breaches == []
    assert runner.jobs == {}
    assert {len(job.history) for job in runner.prepared} == {0, 16}
    assert all(job.constraints and job.embedding is not None and job.job_id < 0 for job in runner.prepared)
    assert {job.num_steps for job in runner.prepared} == {FACTS.min_steps}


def _guided_runner(fixed_s: float = 0.01) -> FakeRunner:
    """A window with constraints takes four evaluations a step, one without one; each takes a millisecond."""
    runner = FakeRunner(FakeClock())
    runner.passes = lambda job: 4 if job.constraints else 1

    def step_s(rows: int) -> float:
        return fixed_s + 0.001 * sum(runner.passes(runner.jobs[job_id]) for job_id in runner.batches[-1])

    runner.step_s = step_s
    return runner


@pytest.mark.parametrize("budget_s", [8.0, 0.0])
def test_profile_measures_steps_of_a_lone_window_without_constraints(budget_s: float) -> None:
    runner = _guided_runner()
    step = profile(runner, runner.clock, max_rows=8, history_frames=16, budget_s=budget_s).costs.step
    known = (1, 2, 4, 8, 16, 32) if budget_s else (1, 4)
    assert [step.seconds(size) for size in known] == pytest.approx([0.01 + 0.001 * size for size in known])
    assert runner.breaches == []
    for _ in range(300):
        step.observe(1, 0.011)
    assert step.seconds(4) == pytest.approx(0.014, rel=0.01), "a lone window says nothing about larger steps"


def test_one_window_is_allowed_although_two_without_constraints_do_not_fit() -> None:
    runner = _guided_runner()
    runner.fails = _too_large("decode", 1)
    assert profile(runner, runner.clock, 32, 16).max_rows == 1


class _Turns:
    """Turns of a device; before each of them other engines work for 30 ms."""

    def __init__(self, clock: FakeClock) -> None:
        self._clock = clock
        self.is_held = False

    def __enter__(self) -> None:
        assert not self.is_held
        self.is_held = True
        self._clock.advance(0.03)

    def __exit__(self, *_: object) -> None:
        self.is_held = False


def test_waiting_for_a_turn_is_not_part_of_the_cost_of_a_call() -> None:
    runner = _runner()
    turns = _Turns(runner.clock)
    outside: list[str] = []

    def note(call: str, job_ids: Sequence[int]) -> bool:
        outside.extend([call] * (not turns.is_held))
        return False

    runner.fails = note
    costs = profile(runner, runner.clock, 4, 16, turn=turns).costs
    assert [costs.step.seconds(rows) for rows in (1, 2, 4)] == pytest.approx([0.011, 0.012, 0.014])
    assert costs.prepare.seconds(4) < 1e-6
    assert costs.decode.seconds(4) < 1e-6
    assert outside == []


def test_profiling_a_slow_machine_stays_within_its_budget() -> None:
    runner = _runner(fixed_s=0.2)
    began = runner.clock.now()
    measured = profile(runner, runner.clock, max_rows=32, history_frames=16, budget_s=4.0)
    assert runner.clock.now() - began <= 4.0
    assert measured.max_rows == 32
    assert max(len(batch) for batch in runner.batches) < 32


def test_the_first_size_is_measured_however_long_it_takes() -> None:
    runner = _runner(fixed_s=3.0)
    assert profile(runner, runner.clock, 32, 16, budget_s=0.0).costs.step.seconds(1) == pytest.approx(3.001)


@pytest.mark.parametrize("call", ["prepare", "denoise", "decode"])
def test_steps_are_no_larger_than_memory_allows(call: str) -> None:
    runner = _runner()
    runner.fails = _too_large(call, 5)
    assert profile(runner, runner.clock, 32, 16).max_rows == 4
    assert runner.jobs == {}


def test_device_without_memory_for_one_window_is_reported() -> None:
    runner = _runner()
    runner.fails = _too_large("denoise", 0)
    with pytest.raises(UnsoundModel, match="memory"):
        profile(runner, runner.clock, 32, 16)


def test_model_that_makes_non_finite_frames_is_reported() -> None:
    runner = _runner()
    runner.poisoned_result = lambda job: True
    with pytest.raises(UnsoundModel, match="not finite"):
        profile(runner, runner.clock, 32, 16)


def _too_large(call: str, room: int) -> Callable[[str, Sequence[int]], bool]:
    def fails(called: str, job_ids: Sequence[int]) -> bool:
        if called == call and len(job_ids) > room:
            raise OutOfMemory
        return False

    return fails


@pytest.mark.parametrize("times", [(0.5, 0.05, 0.02), (0.5, 0.02, 0.05)])
def test_shortest_of_three_runs_of_a_size_counts(times: tuple[float, ...]) -> None:
    """The first one also pays for what is built for the size, and others on the machine may delay any."""
    runner, steps = FakeRunner(FakeClock()), itertools.count()
    runner.step_s = lambda rows: times[next(steps) // FACTS.min_steps]

    def slow(call: str, _: Sequence[int]) -> bool:
        if call in ("prepare", "decode"):
            runner.clock.advance(0.1 * times[min(2, len(runner.decoded))])
        return False

    runner.fails = slow
    costs = profile(runner, runner.clock, max_rows=1, history_frames=16).costs
    assert len(runner.decoded) == len(times)
    assert costs.step.seconds(1) == pytest.approx(0.02)
    assert costs.prepare.seconds(1) == pytest.approx(0.002)
    assert costs.decode.seconds(1) == pytest.approx(0.002)
