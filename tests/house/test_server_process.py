"""The servers of tests: none stays, and each has the settings that were asked for."""

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


def test_what_it_tells_and_what_it_ends_with_are_given() -> None:
    process = started(ENDS)
    with ready(process) as told:
        assert told == {"grpc_port": 7}
    assert process.returncode == 3


def test_one_that_does_not_end_is_killed() -> None:
    process = started(DEAF)
    with pytest.raises(DidNotEnd, match=r"within 0\.05 s"), ready(process, limit_s=0.05):
        pass
    assert process.returncode == -signal.SIGKILL


def test_one_whose_test_has_failed_is_killed() -> None:
    process = started(DEAF)
    with pytest.raises(ZeroDivisionError), ready(process):
        raise ZeroDivisionError
    assert process.returncode == -signal.SIGKILL


def test_one_that_does_not_start_says_why() -> None:
    with (
        pytest.raises(RuntimeError, match="exit code 2:\nno room"),
        ready(started("import sys; sys.stderr.write('no room'); sys.exit(2)")),
    ):
        pass


def test_devices_that_are_given_are_all_that_there_are() -> None:
    ordinary = ("--port", "0", "--devices", "cpu:1", "--log-level", "WARNING")
    assert over(ordinary, ("--devices", "cpu:2", "--devices", "cpu:3")) == [
        "--port", "0", "--log-level", "WARNING", "--devices", "cpu:2", "--devices", "cpu:3",
    ]  # fmt: skip
    assert over(ordinary, ("--port", "5")) == [*ordinary, "--port", "5"]
