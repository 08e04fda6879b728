"""Whatever becomes of the engine process or of its gateway: every session hears of its end, and service goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from motiongen_server.config import ServerConfig
from motiongen_server.engine.types import Chunk, Closed, CloseReason, Opened
from motiongen_server.engine_process.connection import EngineLost
from motiongen_server.engine_process.gateway import LOSSES, RemoteEngine
from motiongen_server.errors import SettingError
from tests.server.engine_process.audience import LIMIT_S, Audience, command, is_gone, opening, play, playhead, remote
from tests.server.engine_process.fake_engine import FATAL_SEED

ROOT = Path(__file__).resolve().parents[3]


def open_anew(engine: RemoteEngine, seed: int = 1) -> None:
    """Ask until an engine process takes the session; every refusal says when to ask again."""
    ends_at = time.monotonic() + LIMIT_S
    while (refusal := engine.submit(opening(seed=seed))) is not None:
        assert refusal.reason == "ENGINE_RESTARTING"
        assert refusal.retry_after_s is not None
        assert refusal.retry_after_s > 0
        assert time.monotonic() < ends_at
        time.sleep(0.02)


def test_a_killed_engine_ends_its_sessions_and_another_takes_its_place() -> None:
    with remote() as (engine, audience):
        engine.submit(opening())
        audience.wait_for_frames(40)
        first = engine.pid
        assert first is not None
        os.kill(first, signal.SIGSTOP)  # so that the edit cannot be answered any more
        assert engine.submit(play(2)) is None
        os.kill(first, signal.SIGKILL)
        closed = audience.wait_for_end()
        assert (closed.reason, closed.code.name) == (CloseReason.ENGINE_FAULT, "UNAVAILABLE")
        assert audience.answers() == [(2, "CANCELLED")]
        assert engine.num_sessions == 0
        open_anew(engine)
        audience.wait_for_frames(80)
        assert engine.pid != first
        assert engine.failure is None


@pytest.mark.parametrize("how", ["hang", "die", "garbage"])
def test_an_engine_that_hangs_dies_or_talks_nonsense_is_replaced(how: str) -> None:
    with remote(how, hung_s=1.5) as (engine, audience):
        first = engine.pid
        assert first is not None
        engine.submit(opening(seed=FATAL_SEED))
        audience.wait_for(lambda heard: heard.of(Chunk) or heard.of(Closed))
        engine.submit(playhead(30))
        assert audience.wait_for_end().reason is CloseReason.ENGINE_FAULT
        audience.wait_for(lambda _: is_gone(first))
        open_anew(engine)
        audience.wait_for(lambda heard: len(heard.of(Opened)) == 2)
        assert engine.failure is None


def test_lost_too_often_it_fails_as_a_whole() -> None:
    with remote("die") as (engine, audience):
        for number in range(1, LOSSES + 1):
            open_anew(engine, seed=FATAL_SEED)
            audience.wait_for(lambda heard, so_many=number: len(heard.of(Chunk)) >= so_many)
            engine.submit(playhead(30))
            audience.wait_for(lambda heard, so_many=number: len(heard.of(Closed)) == so_many)
        assert engine.join(LIMIT_S)
        assert isinstance(engine.failure, EngineLost)
        assert engine.submit(play(2)) is not None


@pytest.mark.parametrize(
    ("how", "error", "says"),
    [
        ("settings", SettingError, "denoise_steps is too small"),
        ("load", EngineLost, "the disk is gone"),
        ("schema", EngineLost, "mixed versions"),
    ],
)
def test_what_prevents_loading_is_said(how: str, error: type[Exception], says: str) -> None:
    engine = RemoteEngine(ServerConfig(), Audience().deliver, Audience().observe, command(how))
    with pytest.raises(error, match=says):
        engine.load()
    engine.stop()


def test_a_program_that_is_no_engine_is_said_to_be_none() -> None:
    engine = RemoteEngine(ServerConfig(), Audience().deliver, Audience().observe, [sys.executable, "-c", "pass"])
    with pytest.raises(EngineLost, match="exit code 0 before it was ready"):
        engine.load()
    engine.stop()


def test_stopped_before_it_was_started_it_leaves_no_process() -> None:
    engine = RemoteEngine(ServerConfig(), Audience().deliver, Audience().observe, command("nothing"))
    engine.load()
    pid = engine.pid
    assert pid is not None
    engine.stop()
    assert is_gone(pid)
    assert engine.join()


GATEWAY = """
import json, sys, time
from motiongen_server.config import ServerConfig
from motiongen_server.engine_process.gateway import RemoteEngine
engine = RemoteEngine(ServerConfig(), lambda outputs: None, lambda report: None, json.loads(sys.argv[1]))
engine.load()
engine.start()
print(engine.pid, flush=True)
time.sleep(600)
"""


def test_when_the_gateway_is_killed_its_engine_ends_too() -> None:
    gateway = subprocess.Popen(
        [sys.executable, "-c", GATEWAY, json.dumps(command("nothing"))], stdout=subprocess.PIPE, cwd=ROOT, text=True
    )
    assert gateway.stdout is not None
    with gateway.stdout:
        engine = int(gateway.stdout.readline())
        assert not is_gone(engine)
        gateway.kill()
        gateway.wait()
    ends_at = time.monotonic() + LIMIT_S
    while not is_gone(engine):
        assert time.monotonic() < ends_at, "the engine process outlives its gateway"
        time.sleep(0.02)
