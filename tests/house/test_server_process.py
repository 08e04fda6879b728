"""The servers that tests start: none is left running, and each has the requested settings."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.server_process import DidNotEnd, over, ready

TELLS = "import signal, sys; {}; print('{{\"grpc_port\": 7}}', flush=True); signal.pause()"
DEAF = TELLS.format("signal.signal(signal.SIGTERM, signal.SIG_IGN)")
ENDS = TELLS.format("signal.signal(signal.SIGTERM, lambda *_: sys.exit(3))")


def started(code: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_output_and_exit_code_of_a_server_are_returned() -> None:
    process = started(ENDS)
    with ready(process) as told:
        assert told == {"grpc_port": 7}
    assert process.returncode == 3


def test_server_that_does_not_end_is_killed() -> None:
    process = started(DEAF)
    with pytest.raises(DidNotEnd, match=r"within 0\.05 s"), ready(process, limit_s=0.05):
        pass
    assert process.returncode == -signal.SIGKILL


def test_server_of_a_failed_test_is_killed() -> None:
    process = started(DEAF)
    with pytest.raises(ZeroDivisionError), ready(process):
        raise ZeroDivisionError
    assert process.returncode == -signal.SIGKILL


def test_server_that_does_not_start_raises_an_error_with_its_output() -> None:
    with (
        pytest.raises(RuntimeError, match="exit code 2:\nno room"),
        ready(started("import sys; sys.stderr.write('no room'); sys.exit(2)")),
    ):
        pass


def test_given_devices_replace_the_default_ones() -> None:
    ordinary = ("--port", "0", "--devices", "cpu:1", "--log-level", "WARNING")
    assert over(ordinary, ("--devices", "cpu:2", "--devices", "cpu:3")) == [
        "--port", "0", "--log-level", "WARNING", "--devices", "cpu:2", "--devices", "cpu:3",
    ]  # fmt: skip
    assert over(ordinary, ("--port", "5")) == [*ordinary, "--port", "5"]
