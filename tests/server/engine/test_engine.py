"""The loop: opening and closing, failures of the runner, drain and stop, and the thread."""

import queue
import time
from collections import Counter
from collections.abc import Sequence

import pytest

from motiongen_server.engine import loop
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.types import (
    Close,
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
from tests.server.engine.fakes import PROMPT, SEED, FakeClock, FakeRunner
from tests.server.engine.stage import Stage, prompt, spec
from tests.server.engine.viewer import Viewer


def _crowd(num: int, config: EngineConfig | None = None, **fields: object) -> tuple[Stage, list[Viewer]]:
    stage = Stage(config)
    viewers = [stage.open(handle, seed=handle, **fields) for handle in range(1, num + 1)]
    return stage, viewers


# ---- opening and closing ---------------------------------------------------------------------------------------------


def test_sessions_share_the_steps_and_keep_their_own_motion() -> None:
    stage, viewers = _crowd(8)
    stage.run(5.0)
    assert max(len(batch) for batch in stage.runner.batches) == 8
    for viewer in viewers:
        assert {int(row[SEED]) for row in viewer.rows} == {viewer.key.handle}
        assert viewer.underruns == 0
    stage.check_finished()


def test_sessions_opened_together_spread_out() -> None:
    stage, viewers = _crowd(60)
    stage.run(20.0)
    begun = Counter(int(job.created_at / 0.25) for job in stage.runner.prepared if job.created_at > 110.0)
    a_window_lasts = 40 / 20
    assert max(begun.values()) <= 2.5 * len(viewers) * 0.25 / a_window_lasts
    assert all(viewer.underruns == 0 for viewer in viewers)


def test_a_full_server_refuses_at_once_and_takes_again_when_there_is_room() -> None:
    stage, viewers = _crowd(3, EngineConfig(max_sessions=2))
    stage.step()
    refused = viewers[2].refused
    assert refused is not None
    assert (refused.code, refused.reason) == (Code.RESOURCE_EXHAUSTED, "SESSION_LIMIT")
    assert "2" in refused.allowed
    assert refused.field == "open"
    assert refused.retry_after_s is not None
    assert 2.0 <= refused.retry_after_s <= 4.0
    assert sorted(stage.reports[0].opens) == [Code.OK, Code.OK, Code.RESOURCE_EXHAUSTED]
    stage.close(viewers[0])
    again = stage.open(4)
    stage.run(1.0)
    assert again.opened is not None
    assert stage.engine.num_sessions == 2


def test_a_handle_in_use_is_refused_and_its_session_lives_on() -> None:
    stage, (viewer,) = _crowd(1)
    stage.run(0.5)
    seq = 99
    viewer.asked.add(seq)
    stage.engine.submit(Open(spec(viewer.key), seq, stage.clock.now()))
    stage.run(5.0)
    assert (viewer.outcomes[seq].code, viewer.outcomes[seq].reason) == (Code.ALREADY_EXISTS, "HANDLE_IN_USE")
    assert viewer.shown > 90


def test_events_for_no_session_are_answered() -> None:
    stage, (viewer,) = _crowd(1)
    stage.run(0.5)
    stage.close(viewer)
    stage.step()
    late = Viewer(viewer.key, 40, 20)
    stage.viewers[viewer.key] = late
    stage.engine.submit(SetPrompts(viewer.key, 5, stage.clock.now(), (prompt(1),)))
    stage.engine.submit(late.lie(3, stage.clock.now()))
    stage.step()
    assert late.refused is not None
    assert (late.refused.code, late.refused.reason) == (Code.NOT_FOUND, "SESSION_NOT_OPEN")
    stage.engine.submit(Close(SessionKey(9, 9), 5, stage.clock.now()))
    stage.viewers[SessionKey(9, 9)] = other = Viewer(SessionKey(9, 9), 40, 20)
    stage.step()
    assert other.refused is not None


def test_a_close_answers_the_edits_that_wait() -> None:
    stage, (viewer,) = _crowd(1)
    stage.run(1.0)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.step()
    waiting = stage.set_prompts(viewer, prompt(3))
    stage.close(viewer)
    stage.step()
    assert [viewer.outcomes[n].code for n in (seq, waiting)] == [Code.CANCELLED, Code.CANCELLED]
    assert viewer.closed is not None
    assert (viewer.closed.reason, viewer.closed.code) == (CloseReason.CLIENT, Code.OK)
    assert stage.runner.jobs == {}


def test_a_handle_used_again_gets_nothing_of_the_session_before() -> None:
    stage, (old,) = _crowd(1, prompts=(prompt(1),))
    stage.step()
    assert len(stage.runner.jobs) == 1
    stage.engine.submit(old.lie(7, stage.clock.now()))
    stage.close(old)
    new_stage_viewer = Viewer(old.key, 40, 20)
    seen: list[Output] = []

    def deliver(outputs: Sequence[Output]) -> None:
        for output in outputs:
            viewer = old if old.closed is None else new_stage_viewer
            viewer.take(output, stage.clock.now())
            seen.append(output)

    stage.deliver = deliver  # type: ignore[method-assign]
    stage.engine.submit(Open(spec(old.key, seed=500, prompts=(prompt(2),)), 1, stage.clock.now()))
    for _ in range(8):
        stage.step()
    assert old.closed is not None
    assert {int(row[PROMPT]) for row in new_stage_viewer.rows} == {2}
    assert {int(row[SEED]) for row in new_stage_viewer.rows} == {500}
    assert len(new_stage_viewer.rows) == 40
    assert stage.runner.breaches == []


def test_a_silent_session_is_closed_as_idle_and_a_reporting_one_is_not() -> None:
    stage, (talker, silent) = _crowd(2, EngineConfig(idle_timeout_s=5.0))
    stage.silent.add(silent.key)
    stage.run(7.0)
    assert silent.closed is not None
    assert silent.closed.reason is CloseReason.IDLE
    assert talker.closed is None


def test_too_many_waiting_events_are_refused_at_the_door() -> None:
    stage, (viewer,) = _crowd(1, EngineConfig(max_pending_events=3))
    stage.run(0.5)
    seqs = [stage.set_prompts(viewer, prompt(n)) for n in range(5)]
    assert [viewer.outcomes[seq].reason for seq in seqs[3:]] == ["TOO_MANY_PENDING_EVENTS"] * 2
    stage.run(1.0)
    assert viewer.rows[-1][PROMPT] == 2
    stage.check_finished()


def test_priority_decides_who_is_late() -> None:
    stage = Stage(EngineConfig(max_rows=4))
    stage.runner.step_s = lambda rows: 0.06
    heroes = [stage.open(handle, priority=Priority.HERO) for handle in range(1, 4)]
    crowd = [stage.open(handle, priority=Priority.CROWD) for handle in range(10, 40)]
    stage.run(20.0)
    assert sum(viewer.underruns for viewer in heroes) == 0
    assert all(viewer.buffered_to >= 40 for viewer in crowd)
    assert sum(viewer.underruns for viewer in crowd) > 0


# ---- failures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["prepare", "denoise", "decode"])
def test_a_job_that_makes_the_runner_raise_closes_its_session_only(call: str) -> None:
    stage, viewers = _crowd(5)
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
def test_a_fault_that_passes_costs_nobody_a_session(call: str) -> None:
    stage, viewers = _crowd(5)
    faults = iter([True])
    stage.runner.fails = lambda called, job_ids: called == call and next(faults, False)
    stage.run(5.0)
    assert stage.total("runner_faults") == 1
    assert all(viewer.closed is None and viewer.underruns == 0 for viewer in viewers)
    stage.check_finished()


@pytest.mark.parametrize("hook", ["poisoned", "poisoned_result"])
def test_numbers_that_are_not_finite_close_their_session_only(hook: str) -> None:
    stage, viewers = _crowd(5)
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
    stage, (viewer,) = _crowd(1)
    stage.runner.poisoned = lambda job: True
    stage.run(0.5)
    assert viewer.closed is not None
    stage.runner.poisoned = lambda job: False
    again = stage.open(1)
    stage.run(1.0)
    assert again.buffered_to >= 40


# ---- drain, stop, the thread -----------------------------------------------------------------------------------------


def test_a_draining_engine_serves_who_is_there_and_takes_nobody_new() -> None:
    stage, (viewer,) = _crowd(1)
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
    stage, viewers = _crowd(3)
    stage.step()
    assert len(stage.runner.jobs) == 3
    stage.engine.stop()
    assert loop.run(stage.engine) is None
    for viewer in viewers:
        assert viewer.buffered_to == 40
        assert viewer.closed is not None
        assert (viewer.closed.reason, viewer.closed.code) == (CloseReason.DRAINED, Code.UNAVAILABLE)
    assert stage.engine.num_sessions == 0


def test_an_error_of_the_loop_itself_is_kept_and_closes_every_session() -> None:
    stage, (viewer,) = _crowd(1)
    stage.step()

    def broken(report: StepReport) -> list[int]:
        raise ZeroDivisionError

    stage.engine.windows.step = broken  # type: ignore[method-assign]
    assert isinstance(loop.run(stage.engine), ZeroDivisionError)
    assert viewer.closed is not None
    assert viewer.closed.reason is CloseReason.ENGINE_FAULT


class _RealClock:
    def now(self) -> float:
        return time.monotonic()


def test_the_thread_serves_and_ends() -> None:
    outputs: queue.Queue[Output] = queue.Queue()
    reports = []
    runner = FakeRunner(FakeClock())

    def deliver(batch: Sequence[Output]) -> None:
        for output in batch:
            outputs.put(output)

    engine = Engine(runner, _RealClock(), deliver, EngineConfig(), reports.append)
    thread = EngineThread(engine)
    key = SessionKey(1, 1)
    engine.submit(Open(spec(key), 1, time.monotonic()))
    assert isinstance(outputs.get(timeout=10.0), Opened)
    engine.submit(SetPrompts(key, 2, time.monotonic(), (prompt(2),)))
    while not isinstance(output := outputs.get(timeout=10.0), Outcome):
        pass
    assert output.event_seq == 2
    engine.stop()
    assert thread.join(10.0)
    while not isinstance(outputs.get(timeout=10.0), Closed):
        pass
    assert thread.failure is None
    assert runner.breaches == []
    assert sum(report.frames_sent for report in reports) > 0


def test_an_idle_engine_sleeps() -> None:
    stage, (viewer,) = _crowd(1)
    stage.silent.add(viewer.key)
    stage.run(1.0)
    assert stage.step().rows == 0
    assert 0.0 < stage.engine.idle_s() <= 0.5


def test_a_client_that_waits_for_credit_does_not_keep_the_engine_awake() -> None:
    stage, (viewer,) = _crowd(1, lookahead=10)
    stage.run(1.0)
    stage.silent.add(viewer.key)
    stage.run(5.0)
    assert stage.step().rows == 0
    assert stage.engine.idle_s() > 0.0


def test_the_engine_wakes_by_itself_when_a_window_is_due() -> None:
    stage, (viewer,) = _crowd(1)
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
    stage, (one, _) = _crowd(2)
    stage.run(0.5)
    stage.pause(one, True)
    stage.run(2.0)
    counts = [report.sessions for report in stage.reports if report.sessions is not None]
    assert counts[-1] == {(Priority.NEAR, PlayState.PLAYING): 1, (Priority.NEAR, PlayState.PAUSED): 1}


def test_the_heartbeat_follows_the_loop() -> None:
    stage, _ = _crowd(1)
    stage.run(1.0)
    before = stage.clock.now()
    stage.step()
    assert stage.engine.heartbeat_at == before


def test_a_configuration_that_does_not_fit_the_model_is_refused() -> None:
    clock = FakeClock()
    with pytest.raises(ValueError, match="history_crop"):
        Engine(FakeRunner(clock), clock, lambda outputs: None, EngineConfig(history_crop=200))
