"""A server as a child process: ready, stopped, and the errors when it does not start."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motiongen_client.blocking import MotionClient
from motiongen_tools.server_process import ServerFailed, ServerProcess
from tests.conftest import TINY_MODEL

TINY = [
    "--model",
    str(TINY_MODEL),
    "--text-encoder",
    "hashed",
    "--devices",
    "cpu:1",
    "--drain-wait-s",
    "0",
    "--profile-s",
    "0",
]


def test_a_server_is_ready_when_started_and_gone_when_stopped() -> None:
    with ServerProcess(TINY).start() as server:  # which starts no second one
        assert server.pid is not None
        assert server.ready_s > 0
        started = server.pid
        assert server.start().pid == started
        with MotionClient(server.address) as client:
            assert client.catalog.models
    assert server.pid is None
    server.stop()  # a second time does nothing


def test_an_invalid_setting_is_reported_with_the_log() -> None:
    with pytest.raises(ServerFailed, match=r"did not start \(exit code 2\)") as failure:
        ServerProcess(["--denoise-steps", "0"]).start()
    assert "denoise_steps is 0" in failure.value.log_tail


def test_a_server_that_is_not_ready_in_time_is_killed_and_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[str]] = []

    class Noted(subprocess.Popen[str]):
        def __init__(self, *arguments: Any, **settings: Any) -> None:
            super().__init__(*arguments, **settings)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Noted)
    server = ServerProcess(TINY, ready_timeout_s=0.01)
    with pytest.raises(ServerFailed, match=r"not ready within 0\.01 s"):
        server.start()
    assert [process.returncode for process in started] == [-signal.SIGKILL], "set once it has been waited for"
    assert server.pid is None


@pytest.mark.parametrize("line", ["fetching 15 GiB", "fetching 1 GiB\\rfetching 15 GiB\\r"])
def test_a_server_that_starts_slowly_is_waited_for_and_its_log_shown(
    line: str, fake_python: Callable[[str], None], tmp_path: Path
) -> None:
    """It becomes ready only once its log has been shown, however long that takes."""
    for name in ("go", "end"):  # two, since one that is opened again may still give the end of the first write
        os.mkfifo(tmp_path / name)
    ports = json.dumps({"grpc_port": 1, "ops_port": 2})
    waits = [f"read _ < {tmp_path}/{name}" for name in ("go", "end")]
    fake_python(f"trap 'exit 0' TERM; printf '{line}' >&2; {waits[0]}; echo '{ports}'; {waits[1]}; exit 0")
    told: list[str] = []

    def go(line: str) -> None:
        told.append(line)
        if line == "fetching 15 GiB":
            (tmp_path / "go").write_text("\n")

    with ServerProcess(tell=go) as server:
        assert server.address == "127.0.0.1:1"
        (tmp_path / "end").write_text("\n")
    assert told[-1] == "fetching 15 GiB"


def test_a_server_killed_from_outside_is_not_reported_as_too_late(fake_python: Callable[[str], None]) -> None:
    fake_python("kill -9 $$")
    with pytest.raises(ServerFailed, match=r"did not start \(exit code -9\)"):
        ServerProcess(ready_timeout_s=100).start()


def test_an_error_in_the_block_is_not_hidden_by_the_death_of_the_server() -> None:
    def kill_and_fail(server: ServerProcess) -> None:
        assert server.pid is not None
        os.kill(server.pid, signal.SIGKILL)
        raise KeyError("first")

    with pytest.raises(KeyError, match="first"), ServerProcess(TINY) as server:
        kill_and_fail(server)


@pytest.fixture
def fake_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Puts a shell script in place of Python."""

    def write(script: str) -> None:
        program = tmp_path / "python"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(program))

    return write


@pytest.fixture
def logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which servers' logs are made."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_the_log_of_a_failure_is_kept_and_named(fake_python: Callable[[str], None], logs: Path) -> None:
    fake_python("echo many lines >&2; exit 3")
    with pytest.raises(ServerFailed) as failure:
        ServerProcess().start()
    (log,) = logs.iterdir()
    assert f"all of which is in {log}" in str(failure.value)
    assert log.read_text() == "many lines\n"


@pytest.mark.parametrize("script", ["echo no ports", 'echo \'{"grpc_port": 1, "ops_port": 2}\'; exit 3'])
def test_a_log_that_no_message_names_is_removed(script: str, fake_python: Callable[[str], None], logs: Path) -> None:
    fake_python(script)
    with pytest.raises((json.JSONDecodeError, KeyError)), ServerProcess():
        raise KeyError("of the command's own, or an interruption")
    assert list(logs.iterdir()) == []


def test_a_process_that_never_became_a_server_is_ended(fake_python: Callable[[str], None], tmp_path: Path) -> None:
    fake_python(f"echo $$ > {tmp_path}/pid; echo no ports; exec sleep 1000")
    with pytest.raises(json.JSONDecodeError), ServerProcess():
        pass
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_a_server_that_is_not_installed_is_reported(fake_python: Callable[[str], None]) -> None:
    fake_python("echo 'python: No module named motiongen_server' >&2; exit 1")
    with pytest.raises(ServerFailed, match="install motiongen-server"):
        ServerProcess().start()
