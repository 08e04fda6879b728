"""Overload: memory that runs out, a device that is lost, more sessions than the machine can serve."""

from collections.abc import Callable, Sequence
from itertools import chain

import pytest

from motiongen_server.engine import loop
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.ports import DeviceLost, OutOfMemory
from motiongen_server.engine.session import emission
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import (
    Close,
    CloseReason,
    Code,
    Open,
    PlayState,
    Priority,
    ServiceLevel,
    ServiceTier,
    SessionKey,
)
from tests.server.engine.stage import Stage, crowd, prompt, spec
from tests.server.engine.viewer import Viewer

CALLS = ("prepare", "denoise", "decode")


# ---- memory and device -----------------------------------------------------------------------------------------------


def _fits(call: str, room: int) -> Callable[[str, Sequence[int]], bool]:
    def fails(called: str, job_ids: Sequence[int]) -> bool:
        if called == call and len(job_ids) > room:
            raise OutOfMemory(f"{len(job_ids)} jobs")
        return False

    return fails


@pytest.mark.parametrize("call", CALLS)
def test_out_of_memory_splits_batches_and_closes_no_session(call: str) -> None:
    stage, viewers = crowd(16)
    stage.runner.fails = _fits(call, 3)
    stage.run(10.0)
    assert stage.total("memory_splits") == 3  # 16, 8, 4: from then on calls are small enough
    assert stage.total("runner_faults") == 0
    assert all(viewer.closed is None and viewer.underruns == 0 for viewer in viewers)
    stage.check_finished()


@pytest.mark.parametrize("call", CALLS)
def test_window_that_does_not_fit_even_alone_closes_only_its_session(call: str) -> None:
    stage, viewers = crowd(5)
    owners = stage.engine.windows.owners

    def fails(called: str, job_ids: Sequence[int]) -> bool:
        if called == call and any(owners[job_id].key == viewers[1].key for job_id in job_ids):
            raise OutOfMemory
        return False

    stage.runner.fails = fails
    stage.run(5.0)
    closed = viewers[1].closed
    assert closed is not None
    assert (closed.reason, closed.code) == (CloseReason.ENGINE_FAULT, Code.INTERNAL)
    assert "memory" in closed.message
    assert all(viewer.closed is None for viewer in viewers if viewer is not viewers[1])
    assert owners.keys() == stage.runner.jobs.keys()


@pytest.mark.parametrize("call", CALLS)
def test_a_lost_device_ends_the_engine_and_closes_every_session(call: str) -> None:
    stage, viewers = crowd(4)

    def fails(called: str, job_ids: Sequence[int]) -> bool:
        if called == call:
            raise DeviceLost("the device is gone")
        return False

    stage.runner.fails = fails
    assert isinstance(loop.run(stage.engine), DeviceLost)
    for viewer in viewers:
        assert viewer.closed is not None
        assert (viewer.closed.reason, viewer.closed.code) == (CloseReason.ENGINE_FAULT, Code.INTERNAL)
    refusal = stage.engine.submit(Open(spec(SessionKey(9, 9)), 1, stage.clock.now()))
    assert refusal is not None
    assert refusal.code is Code.UNAVAILABLE


# ---- more than the machine can serve ---------------------------------------------------------------------------------


def test_sessions_beyond_the_capacity_are_refused_as_overloaded() -> None:
    stage, viewers = crowd(10)
    stage.runner.step_s = lambda rows: 0.005 * rows  # 0.5 windows a second of 4 steps: 10 ms a second and session
    stage.run(5.0)
    waves = []
    for wave in range(1, 5):  # clients that were refused try again
        waves.append([stage.open(100 * wave + number) for number in range(60)])
        assert len(stage.step().opens) == 60
        stage.run(2.5)
    let_in = [[viewer for viewer in wave if viewer.refused is None] for wave in waves]
    assert len(let_in[0]) < 45  # a rush waits for its first windows
    assert 70 <= len(viewers) + sum(map(len, let_in)) <= 95
    refused = waves[-1][-1].refused
    assert refused is not None
    assert (refused.code, refused.reason) == (Code.RESOURCE_EXHAUSTED, "OVERLOADED")
    assert refused.retry_after_s is not None
    assert not any(viewer.underruns for viewer in chain(viewers, *let_in))


def test_place_is_free_as_soon_as_the_close_is_submitted() -> None:
    stage, (viewer,) = crowd(1, EngineConfig(max_sessions=1))
    stage.run(0.5)
    assert stage.engine.submit(Open(spec(SessionKey(2, 2)), 1, 0.0)) is not None
    stage.engine.submit(Close(viewer.key, 9, stage.clock.now()))
    stage.viewers[SessionKey(2, 2)] = later = Viewer(SessionKey(2, 2), 40, 20)
    assert stage.engine.submit(Open(spec(later.key), 1, stage.clock.now())) is None
    stage.step()
    assert viewer.closed is not None
    assert later.opened is not None


def _levels(stage: Stage, viewer: Viewer) -> list[ServiceLevel]:
    return [output for output in stage.outputs if isinstance(output, ServiceLevel) and output.session == viewer.key]


def test_crowd_sessions_are_degraded_first_told_so_and_restored_later() -> None:
    stage = Stage(EngineConfig(max_rows=4, admit_load=(9.0, 9.0, 9.0, 9.0)))
    hero = stage.open(1, priority=Priority.HERO)
    crowd = [stage.open(handle, priority=Priority.CROWD) for handle in range(2, 32)]
    stage.runner.step_s = lambda rows: 0.08
    stage.runner.holds = True
    stage.run(20.0)
    told = [level.tier for level in _levels(stage, crowd[0])]
    assert told[0] is ServiceTier.FEWER_STEPS
    assert told == sorted(told)
    assert told[-1] > told[0]
    assert _levels(stage, hero) == []
    assert hero.underruns == 0
    assert min(job.num_steps for job in stage.runner.prepared if job.priority is Priority.CROWD) < 4
    stage.runner.step_s = lambda rows: 0.002
    stage.run(120.0)
    last = _levels(stage, crowd[0])[-1]
    assert (last.tier, last.denoise_steps) == (ServiceTier.FULL, 4)
    stage.check_finished()


def test_session_opened_under_overload_is_told_its_service_level() -> None:
    stage = Stage(EngineConfig(max_rows=4, admit_load=(9.0, 9.0, 9.0, 9.0)))
    for handle in range(1, 40):
        stage.open(handle, priority=Priority.CROWD)
    stage.runner.step_s = lambda rows: 0.08
    stage.run(12.0)
    late = stage.open(99, priority=Priority.CROWD)
    stage.step()
    assert [level.tier > ServiceTier.FULL for level in _levels(stage, late)] == [True]


def test_no_session_is_degraded_when_degrade_is_off() -> None:
    stage = Stage(EngineConfig(max_rows=4, degrade=False, admit_load=(9.0, 9.0, 9.0, 9.0)))
    viewers = [stage.open(handle, priority=Priority.CROWD) for handle in range(1, 40)]
    stage.runner.step_s = lambda rows: 0.08
    stage.run(30.0)
    assert not any(isinstance(output, ServiceLevel) for output in stage.outputs)
    assert all(viewer.closed is None for viewer in viewers)
    assert sum(viewer.underruns for viewer in viewers) > 0


# ---- a step costs only what has changed ------------------------------------------------------------------------------


def test_step_looks_only_at_sessions_with_new_events(monkeypatch: pytest.MonkeyPatch) -> None:
    stage, viewers = crowd(50)
    stage.run(1.0)
    stage.silent.update(viewer.key for viewer in viewers)
    while stage.step().rows:
        pass
    looked_at: list[SessionKey] = []
    emit = emission.emit

    def counted(state: SessionState, *arguments: object) -> object:
        looked_at.append(state.key)
        return emit(state, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(emission, "emit", counted)
    stage.report(viewers[7])
    stage.step()
    assert set(looked_at) == {viewers[7].key}


def test_number_of_scheduled_wake_ups_stays_bounded() -> None:
    stage, viewers = crowd(10)
    for _ in range(300):
        stage.run(0.02)
        stage.set_prompts(viewers[0], prompt(1))
        for viewer in viewers:
            stage.report(viewer)
    assert stage.engine.sessions.num_wake_ups <= 2 * len(viewers) + 64


def test_session_counts_follow_opens_pauses_and_closes() -> None:
    stage, viewers = crowd(3)
    stage.run(0.5)
    stage.pause(viewers[0], True)
    stage.step()
    stage.pause(viewers[0], True)
    stage.step()
    stage.close(viewers[1])
    stage.close(viewers[0])
    counts = stage.step().sessions
    assert counts == {(Priority.NEAR, PlayState.PLAYING): 1}
