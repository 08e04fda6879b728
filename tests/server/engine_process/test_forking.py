"""Forked engine processes: how each ended is reported, and none depends on its fork server or on another process."""

from __future__ import annotations

import errno
import json
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from motiongen_server.engine_process import forking
from motiongen_server.engine_process.child import END_S
from motiongen_server.engine_process.forking import ForkedChild, ForkServerLink
from tests.conftest import ROOT
from tests.server.engine_process.audience import is_gone
from tests.waiting import until

FORK_SERVER = (sys.executable, "-m", "tests.server.engine_process.fake_fork_server")
PATIENCE_S = 90.0
"""The longest wait for an end that must come; nothing is measured by it."""


@pytest.fixture
def link() -> Iterator[ForkServerLink]:
    fork_server = ForkServerLink(FORK_SERVER)
    yield fork_server
    fork_server.stop()
    fork_server.join(END_S)
    assert fork_server.pid is None or is_gone(fork_server.pid)


@pytest.fixture
def start(link: ForkServerLink, tmp_path: Path) -> Iterator[Callable[..., ForkedChild]]:
    """Starts a process that lives until it is ended, or that exits with a code. All are ended afterwards."""
    children: list[ForkedChild] = []

    def start_one(code: int | None = None, **environment: str) -> ForkedChild:
        folder = tmp_path / str(len(children))
        folder.mkdir()
        if code is not None:
            (folder / "code").write_text(str(code), encoding="ascii")
        child = link.start(folder, environment)
        children.append(child)
        if code is None:
            until(lambda: (folder / "environment").exists())
        return child

    yield start_one
    for child in children:
        child.end(0.0)
        child.close()


def has_died(child: ForkedChild) -> bool:
    return bool(select.select([child], [], [], 0.0)[0])


def test_exit_codes_and_signals_are_reported(start: Callable[..., ForkedChild]) -> None:
    assert start(code=0).end(PATIENCE_S) == "ended with exit code 0"
    assert start(code=7).end(PATIENCE_S) == "ended with exit code 7"
    child = start()
    os.kill(child.pid, signal.SIGUSR1)
    assert child.end(PATIENCE_S) == "killed by SIGUSR1"
    child = start()
    os.kill(child.pid, signal.SIGRTMIN + 6)
    assert child.end(PATIENCE_S) == f"killed by signal {signal.SIGRTMIN + 6}", "this signal has no name"


def test_process_that_misses_its_deadline_is_killed(start: Callable[..., ForkedChild]) -> None:
    child = start()
    assert not has_died(child)
    assert child.end(0.0) == "killed by SIGKILL"
    assert has_died(child)
    child.kill()  # does nothing: the process id may belong to another process by now


def test_process_gets_its_own_environment_on_top_of_the_gateway_s(
    start: Callable[..., ForkedChild], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOTIONGEN_TEST", "gateway")
    start(OMP_NUM_THREADS="4")
    start(OMP_NUM_THREADS="2")
    found = [json.loads((tmp_path / name / "environment").read_text(encoding="utf-8")) for name in ("0", "1")]
    assert [each["OMP_NUM_THREADS"] for each in found] == ["4", "2"]
    assert [each["MOTIONGEN_TEST"] for each in found] == ["gateway"] * 2


def test_processes_have_one_parent_and_outlive_each_other(
    link: ForkServerLink, start: Callable[..., ForkedChild]
) -> None:
    first, second = start(), start()
    assert [psutil.Process(child.pid).ppid() for child in (first, second)] == [link.pid] * 2
    first.kill()
    assert first.end(PATIENCE_S) == "killed by SIGKILL"
    assert not has_died(second)


def test_processes_outlive_their_fork_server_and_the_next_start_gets_a_new_one(
    link: ForkServerLink, start: Callable[..., ForkedChild]
) -> None:
    child, fork_server = start(), link.pid
    assert fork_server is not None
    os.kill(fork_server, signal.SIGKILL)
    until(lambda: is_gone(fork_server))
    assert not has_died(child)
    following = start()
    assert link.pid != fork_server
    assert child.end(0.0) == "ended after what it was forked from"
    until(lambda: is_gone(child.pid))
    assert following.end(0.0) == "killed by SIGKILL"


def test_fork_server_that_stops_answering_is_replaced(
    link: ForkServerLink, start: Callable[..., ForkedChild], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child, fork_server = start(), link.pid
    assert fork_server is not None
    os.kill(fork_server, signal.SIGSTOP)
    with monkeypatch.context() as patched:
        patched.setattr(forking, "FORK_S", 0.1)
        with pytest.raises(ChildProcessError):
            link.start(tmp_path, {})
    until(lambda: is_gone(fork_server))
    assert not has_died(child)
    following = start()
    assert link.pid != fork_server
    assert following.end(0.0) == "killed by SIGKILL"


def test_start_that_runs_out_of_pipes_closes_those_it_made(
    link: ForkServerLink, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []
    pipe = os.pipe

    def scarce() -> tuple[int, int]:
        if len(made) >= 4:
            raise OSError(errno.EMFILE, "too many open files")
        made.extend(ends := pipe())
        return ends

    monkeypatch.setattr(os, "pipe", scarce)
    with pytest.raises(OSError, match="too many open files"):
        link.start(tmp_path, {})
    for descriptor in made:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(descriptor)


def test_stopped_fork_server_forks_no_more_and_ends_after_its_last_process(
    link: ForkServerLink, start: Callable[..., ForkedChild]
) -> None:
    child, fork_server = start(), link.pid
    assert fork_server is not None
    link.stop()
    with pytest.raises(ChildProcessError, match="going away"):
        start()
    assert not has_died(child)
    os.kill(child.pid, signal.SIGKILL)
    link.join(PATIENCE_S)
    assert is_gone(fork_server)
    assert child.end(PATIENCE_S) == "killed by SIGKILL"


GATEWAY = """
import json, signal, sys
from pathlib import Path
from motiongen_server.engine_process.forking import ForkServerLink
link = ForkServerLink(json.loads(sys.argv[1]))
child = link.start(Path(sys.argv[2]), {})
print(link.pid, child.pid, flush=True)
signal.pause()
"""


def test_fork_server_and_its_processes_end_when_the_gateway_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", GATEWAY, json.dumps(FORK_SERVER), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, text=True) as gateway:
        assert gateway.stdout is not None
        pids = [int(pid) for pid in gateway.stdout.readline().split()]
        assert len(pids) == 2
        assert not any(is_gone(pid) for pid in pids)
        gateway.kill()
    until(lambda: all(is_gone(pid) for pid in pids))


def test_stop_fails_a_start_that_waits_for_the_first_fork(tmp_path: Path) -> None:
    link = ForkServerLink((sys.executable, "-c", "import time; time.sleep(1000)"))  # it never forks
    errors: list[Exception] = []

    def ask() -> None:
        try:
            link.start(tmp_path, {})
        except OSError as error:
            errors.append(error)

    asking = threading.Thread(target=ask)
    asking.start()
    until(lambda: link.pid is not None)
    link.stop()
    asking.join()
    link.join(END_S)
    assert [type(error) for error in errors] == [ChildProcessError]


def test_program_that_ends_without_forking_fails_every_start(tmp_path: Path) -> None:
    link = ForkServerLink((sys.executable, "-c", "pass"))
    for _ in range(2):
        with pytest.raises(OSError):  # noqa: PT011  it may end before it is asked, or after
            link.start(tmp_path, {})
    link.stop()
    link.join(END_S)
