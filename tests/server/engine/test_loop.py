"""The engine's loop: draining, stopping, its thread, and when it sleeps."""

import queue
import time
from collections.abc import Sequence

import pytest

from motiongen_server.engine import loop
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.types import (
    Closed,
    CloseReason,
    Code,
    Open,
    Opened,
    Outcome,
    Output,
    PlayState,
    Priority,
    SessionKey,
    SetPrompts,
)
from motiongen_server.engine.types.report import StepReport
from tests.server.engine.engine_thread import EngineThread
from tests.server.engine.fakes import FakeClock, FakeRunner, RealTime
from tests.server.engine.stage import crowd, prompt, spec
from tests.waiting import LIMIT_S


def test_draining_engine_serves_open_sessions_and_refuses_new_ones() -> None:
    stage, (viewer,) = crowd(1)
    stage.run(1.0)
    stage.engine.drain()
    refused = stage.open(2)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(5.0)
    assert refused.refused is not None
    assert (refused.refused.code, refused.refused.reason) == (Code.UNAVAILABLE, "DRAINING")
    assert viewer.outcomes[seq].code is Code.OK
    assert viewer.underruns == 0


def test_stopping_finishes_the_running_windows_and_closes_every_session() -> None:
    stage, viewers = crowd(3)
    stage.step()
    assert len(stage.runner.jobs) == 3
    stage.engine.stop()
    assert loop.run(stage.engine) is None
    for viewer in viewers:
        assert viewer.buffered_to == 40
        assert viewer.closed is not None
        assert (viewer.closed.reason, viewer.closed.code) == (CloseReason.DRAINED, Code.UNAVAILABLE)
    assert stage.engine.num_sessions == 0


def test_error_in_the_loop_is_returned_and_closes_every_session() -> None:
    stage, (viewer,) = crowd(1)
    stage.step()

    def broken(report: StepReport) -> list[int]:
        raise ZeroDivisionError

    stage.engine.windows.step = broken  # type: ignore[method-assign]
    assert isinstance(loop.run(stage.engine), ZeroDivisionError)
    assert viewer.closed is not None
    assert viewer.closed.reason is CloseReason.ENGINE_FAULT


def test_engine_thread_serves_a_session_and_ends_when_stopped() -> None:
    outputs: queue.Queue[Output] = queue.Queue()
    reports = []
    runner = FakeRunner(FakeClock())

    def deliver(batch: Sequence[Output]) -> None:
        for output in batch:
            outputs.put(output)

    engine = Engine(runner, RealTime(), deliver, EngineConfig(), observe=reports.append)
    thread = EngineThread(engine)
    key = SessionKey(1, 1)
    engine.submit(Open(spec(key), 1, time.monotonic()))
    assert isinstance(outputs.get(timeout=LIMIT_S), Opened)
    engine.submit(SetPrompts(key, 2, time.monotonic(), (prompt(2),)))
    while not isinstance(output := outputs.get(timeout=LIMIT_S), Outcome):
        pass
    assert output.event_seq == 2
    engine.stop()
    assert thread.join(LIMIT_S)
    while not isinstance(outputs.get(timeout=LIMIT_S), Closed):
        pass
    assert thread.failure is None
    assert runner.breaches == []
    assert sum(report.frames_sent for report in reports) > 0


def test_engine_does_not_sleep_after_a_failed_step_while_other_windows_wait() -> None:
    stage, (lost, served) = crowd(2, EngineConfig(max_rows=1))
    stage.runner.fails = lambda call, job_ids: call == "prepare" and 1 in job_ids
    left: list[int] = []

    def wait() -> None:
        left.append(len(stage.engine.windows))
        stage.engine.stop()

    stage.engine.wait = wait  # type: ignore[method-assign]
    assert loop.run(stage.engine) is None
    assert left == [0], "it sleeps once nothing is left to do"
    assert lost.closed is not None
    assert lost.closed.reason is CloseReason.ENGINE_FAULT
    assert served.buffered_to == 40


def test_an_idle_engine_sleeps() -> None:
    stage, (viewer,) = crowd(1)
    stage.silent.add(viewer.key)
    stage.run(1.0)
    assert stage.step().rows == 0
    assert 0.0 < stage.engine.idle_s() <= 0.5


def test_session_without_credit_does_not_keep_the_engine_awake() -> None:
    stage, (viewer,) = crowd(1, lookahead=10)
    stage.run(1.0)
    stage.silent.add(viewer.key)
    stage.run(5.0)
    assert stage.step().rows == 0
    assert stage.engine.idle_s() > 0.0


def test_the_engine_wakes_by_itself_when_a_window_is_due() -> None:
    stage, (viewer,) = crowd(1)
    stage.run(0.2)
    stage.silent.add(viewer.key)
    windows = len(stage.runner.prepared)
    rounds = 0
    while len(stage.runner.prepared) == windows:
        assert stage.engine.idle_s() <= 0.5
        stage.clock.advance(stage.engine.idle_s())
        stage.step()
        rounds += 1
        assert rounds < 10
    job = stage.runner.prepared[-1]
    unplayed = 40 - (job.created_at - (viewer.played_at or 0.0)) * 20
    assert 19 < unplayed <= 24


def test_sessions_are_counted_by_class_and_state() -> None:
    stage, (one, _) = crowd(2)
    stage.run(0.5)
    stage.pause(one, True)
    stage.run(2.0)
    counts = [report.sessions for report in stage.reports if report.sessions is not None]
    assert counts[-1] == {(Priority.NEAR, PlayState.PLAYING): 1, (Priority.NEAR, PlayState.PAUSED): 1}


def test_heartbeat_is_the_time_at_which_the_last_step_began() -> None:
    stage, _ = crowd(1)
    stage.run(1.0)
    before = stage.clock.now()
    stage.step()
    assert stage.engine.heartbeat_at == before


def test_a_configuration_that_does_not_fit_the_model_is_refused() -> None:
    clock = FakeClock()
    with pytest.raises(ValueError, match="history_crop"):
        Engine(FakeRunner(clock), clock, lambda outputs: None, EngineConfig(history_crop=200))
