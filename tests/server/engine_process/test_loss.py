"""Losses of engine processes and of their gateway: every session hears of its end, and service continues."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from motiongen_server.config import ServerConfig
from motiongen_server.devices import EngineDevice
from motiongen_server.engine.types import Chunk, Closed, CloseReason, Opened, Output, Priority, ServiceTier, SessionKey
from motiongen_server.engine_process.connection import EngineLost, LoadFailed
from motiongen_server.engine_process.group import EngineGroup
from motiongen_server.engine_process.pool import EnginePool
from motiongen_server.engine_process.restarts import LOSSES
from motiongen_server.settings import SettingError
from tests.server.engine_process.audience import (
    KEY,
    LIMIT_S,
    Audience,
    Remote,
    close,
    command,
    is_gone,
    opening,
    play,
    playhead,
    pool_of,
    remote,
    stop,
)
from tests.server.engine_process.fake_engine import FATAL_SEED
from tests.waiting import until

ROOT = Path(__file__).resolve().parents[3]


def open_anew(engine: EngineGroup, seed: int = 1, key: SessionKey = KEY) -> None:
    """Asks until an engine process admits the session; every refusal must say when to ask again."""

    def is_taken() -> bool:
        refusal = engine.submit(opening(key, seed))
        if refusal is not None:
            assert refusal.reason == "ENGINE_RESTARTING"
            assert refusal.retry_after_s is not None
            assert refusal.retry_after_s > 0
        return refusal is None

    until(is_taken)


def test_killed_engine_ends_its_sessions_and_is_replaced() -> None:
    with remote() as there:
        engine, audience = there.engine, there.audience
        engine.submit(opening())
        audience.wait_for_frames(40)
        first = there.pid()
        assert first is not None
        stop(first)  # so that the edit cannot be answered
        assert engine.submit(play(2)) is None
        os.kill(first, signal.SIGKILL)
        closed = audience.wait_for_end()
        assert (closed.reason, closed.code.name) == (CloseReason.ENGINE_FAULT, "UNAVAILABLE")
        assert audience.answers() == [(2, "CANCELLED")]
        assert engine.num_sessions == 0
        open_anew(engine)
        audience.wait_for_frames(80)
        assert there.pid() != first
        assert engine.failure is None
        assert there.pool.processes[0].num_restarts == 1


def test_engine_stuck_while_loading_its_models_again_is_replaced(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """For example because a driver hangs. Only a model that was never loaded may take any time."""
    with remote(f"stuck:{tmp_path}") as there:
        monkeypatch.setattr("motiongen_server.engine_process.silence.LOAD_AGAIN_S", 4.0)
        pid = there.pid()
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        until(lambda: there.pool.processes[0].num_restarts == 2)
        open_anew(there.engine)
        there.audience.wait_for_frames(40)
    assert "loading again what the one before it held for" in caplog.text


def test_loss_of_an_engine_without_sessions_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    with remote() as there:
        told: list[Sequence[Output]] = []
        monkeypatch.setattr(there.pool.processes[0], "_deliver", told.append)
        pid = there.pid()
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        until(lambda: told)
        assert told == [()]


def test_lost_engine_is_reported_with_no_sessions_and_no_load() -> None:
    with remote() as there:
        there.engine.submit(opening())
        there.audience.wait_for(lambda heard: any(report.sessions for report in heard.reports))
        pid = there.pid()
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        there.audience.wait_for(lambda heard: any(report.closes for report in heard.reports))
        last = next(report for report in there.audience.reports if report.closes)
        assert last.closes == [CloseReason.ENGINE_FAULT]
        assert (last.sessions, last.load) == ({}, 0.0)
        assert last.tiers == dict.fromkeys(Priority, ServiceTier.FULL)


def test_sessions_of_other_engines_play_on_and_new_ones_go_there() -> None:
    keys = [SessionKey(1, handle) for handle in range(1, 5)]
    with remote(engines=2) as there:
        engine, audience = there.engine, there.audience
        with there.stopped():  # no load is reported meanwhile, which on a busy machine would differ between them
            assert [engine.submit(opening(key)) for key in keys] == [None] * 4
        for key in keys:
            audience.wait_for_frames(40, key)
        assert [process.num_sessions for process in there.pool.processes] == [2, 2]
        pid = there.pid(1)
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        audience.wait_for(lambda heard: sum(len(heard.of(Closed, key)) for key in keys) == 2)
        stayed = [key for key in keys if not audience.of(Closed, key)]
        assert engine.submit(opening(SessionKey(1, 9))) is None, "the other engine has room"
        audience.wait_for_frames(40, SessionKey(1, 9))
        for key in stayed:
            assert engine.submit(playhead(30, key)) is None
            assert engine.submit(play(2, key)) is None
            audience.wait_for_frames(60, key)
            assert audience.answers(key) == [(2, "OK")]
        handles = itertools.count(10)

        def is_given_sessions() -> bool:
            key = SessionKey(1, next(handles))
            assert engine.submit(opening(key)) is None
            is_there = there.pool.processes[1].num_sessions > 0
            assert engine.submit(close(2, key)) is None  # else the other engine would be full before this one is back
            return is_there

        until(is_given_sessions)
        assert all(not audience.of(Closed, key) for key in stayed)


@pytest.mark.parametrize("how", ["hang", "die", "garbage", "fail"])
def test_engine_that_hangs_dies_fails_or_sends_garbage_is_replaced(how: str) -> None:
    with remote(how, hung_s=4.0 if how == "hang" else LIMIT_S) as there:
        engine, audience = there.engine, there.audience
        first = there.pid()
        assert first is not None
        engine.submit(opening(seed=FATAL_SEED))
        audience.wait_for(lambda heard: heard.of(Chunk) or heard.of(Closed))
        engine.submit(playhead(30))
        assert audience.wait_for_end().reason is CloseReason.ENGINE_FAULT
        # an engine that notices its failure closes its sessions itself, before the gateway notices its end
        until(lambda: there.pool.processes[0].num_restarts == 1)
        assert is_gone(first)
        open_anew(engine)
        audience.wait_for(lambda heard: len(heard.of(Opened)) == 2)
        assert engine.failure is None


def die_often(there: Remote) -> None:
    for number in range(1, LOSSES + 1):
        open_anew(there.engine, seed=FATAL_SEED)
        there.audience.wait_for_frames(40 * number)  # all of its first window: output sent just before a death is lost
        there.engine.submit(playhead(30))
        there.audience.wait_for(lambda heard, so_many=number: len(heard.of(Closed)) == so_many)


@pytest.fixture
def losses_are_close(monkeypatch: pytest.MonkeyPatch) -> None:
    """All losses count as close together, however long a busy machine takes to start an engine process."""
    monkeypatch.setattr("motiongen_server.engine_process.restarts.LOSSES_WITHIN_S", math.inf)


@pytest.mark.usefixtures("losses_are_close")
def test_engine_lost_too_often_counts_as_failed() -> None:
    with remote("die") as there:
        die_often(there)
        until(lambda: there.engine.failure)
        assert isinstance(there.engine.failure, EngineLost)
        assert there.engine.submit(play(2)) is not None


@pytest.mark.usefixtures("losses_are_close")
def test_failed_engine_is_started_again_after_a_rest() -> None:
    with remote("die", rest_s=0.1) as there:
        die_often(there)
        open_anew(there.engine)
        there.audience.wait_for(lambda heard: len(heard.of(Opened)) == LOSSES + 1)
        assert there.engine.failure is None


@pytest.mark.parametrize(
    ("how", "error", "says"),
    [
        ("settings", SettingError, "denoise_steps is too small"),
        ("load", LoadFailed, "the disk is gone"),
        ("schema", EngineLost, "mixed versions"),
    ],
)
def test_error_that_prevents_loading_is_raised_with_its_reason(how: str, error: type[Exception], says: str) -> None:
    with pool_of(how, engines=2) as (pool, _), pytest.raises(error, match=says):
        pool.load("fake")


def test_model_that_cannot_be_loaded_does_not_disturb_another() -> None:
    with remote(engines=2) as there:
        there.engine.submit(opening())
        there.audience.wait_for_frames(40)
        with pytest.raises(SettingError):
            there.pool.load("unsound")
        there.engine.submit(playhead(30))
        there.audience.wait_for_frames(60)


def test_program_that_is_no_engine_is_reported_as_ended_before_it_was_ready() -> None:
    audience = Audience()
    pool = EnginePool(
        ServerConfig(),
        [EngineDevice("cpu", 0, 1)],
        audience.deliver,
        audience.observer_of,
        [sys.executable, "-c", "pass"],
    )
    with pytest.raises(EngineLost, match="exit code 0 before it was ready"):
        pool.load("fake")
    pool.stop()
    assert pool.join(LIMIT_S)


def test_pool_stopped_with_a_model_loaded_leaves_no_process() -> None:
    with pool_of() as (pool, _):
        pool.load("fake")
        pid = pool.processes[0].pid
        assert pid is not None
        pool.stop()
        assert pool.join(LIMIT_S)
        assert is_gone(pid)


GATEWAY = """
import json, signal, sys
from motiongen_server.config import ServerConfig
from motiongen_server.devices import EngineDevice
from motiongen_server.engine_process.pool import EnginePool
pool = EnginePool(
    ServerConfig(), [EngineDevice("cpu", 0, 1)], lambda outputs: None, lambda *_: lambda report: None,
    json.loads(sys.argv[1]),
)
pool.load("fake")
print(pool.processes[0].pid, flush=True)
signal.pause()
"""


def test_engine_ends_when_its_gateway_is_killed() -> None:
    gateway = subprocess.Popen(
        [sys.executable, "-c", GATEWAY, json.dumps(command("nothing"))], stdout=subprocess.PIPE, cwd=ROOT, text=True
    )
    assert gateway.stdout is not None
    with gateway.stdout:
        engine = int(gateway.stdout.readline())
        assert not is_gone(engine)
        gateway.kill()
        gateway.wait()
    until(lambda: is_gone(engine))


def test_fault_in_the_gateway_s_own_thread_counts_as_a_failed_engine() -> None:
    with remote() as there:
        there.engine.submit(opening())
        there.audience.wait_for_frames(40)
        process, pid = there.pool.processes[0], there.pid()
        assert pid is not None

        def fail() -> None:
            raise ZeroDivisionError("whoever is told of a loss")

        process.serve_text(lambda message: None, tuple, fail)
        os.kill(pid, signal.SIGKILL)
        assert there.audience.wait_for_end().reason is CloseReason.ENGINE_FAULT
        until(lambda: there.engine.failure is not None)  # this lets the server end and be started again
        assert isinstance(there.engine.failure, ZeroDivisionError)
        refusal = there.engine.submit(opening())
        assert refusal is not None
        assert refusal.reason == "ENGINE_RESTARTING"
        with pytest.raises(EngineLost, match="has failed: whoever is told"):
            there.pool.load("fake")
