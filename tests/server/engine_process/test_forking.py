"""Engine processes that are forked: how each ends is told, and none depends on its fork server or on another."""

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
"""Of who waits for an end that must come; nothing is measured by it."""


@pytest.fixture
def link() -> Iterator[ForkServerLink]:
    fork_server = ForkServerLink(FORK_SERVER)
    yield fork_server
    fork_server.stop()
    fork_server.join(END_S)
    assert fork_server.pid is None or is_gone(fork_server.pid)


@pytest.fixture
def start(link: ForkServerLink, tmp_path: Path) -> Iterator[Callable[..., ForkedChild]]:
    """Starts a process that lives until it is killed or let go, or that ends with a code. All are ended afterwards."""
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


def test_an_exit_code_and_a_signal_are_told(start: Callable[..., ForkedChild]) -> None:
    assert start(code=0).end(PATIENCE_S) == "ended with exit code 0"
    assert start(code=7).end(PATIENCE_S) == "ended with exit code 7"
    child = start()
    os.kill(child.pid, signal.SIGUSR1)
    assert child.end(PATIENCE_S) == "killed by SIGUSR1"
    child = start()
    os.kill(child.pid, signal.SIGRTMIN + 6)
    assert child.end(PATIENCE_S) == f"killed by signal {signal.SIGRTMIN + 6}", "it has no name"


def test_who_does_not_end_in_time_is_killed(start: Callable[..., ForkedChild]) -> None:
    child = start()
    assert not has_died(child)
    assert child.end(0.0) == "killed by SIGKILL"
    assert has_died(child)
    child.kill()  # nothing: its number may be another's by now


def test_each_finds_its_own_environment_beside_that_of_the_gateway(
    start: Callable[..., ForkedChild], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOTIONGEN_TEST", "gateway")
    start(OMP_NUM_THREADS="4")
    start(OMP_NUM_THREADS="2")
    found = [json.loads((tmp_path / name / "environment").read_text(encoding="utf-8")) for name in ("0", "1")]
    assert [each["OMP_NUM_THREADS"] for each in found] == ["4", "2"]
    assert [each["MOTIONGEN_TEST"] for each in found] == ["gateway"] * 2


def test_all_have_one_parent_and_the_end_of_one_is_not_noticed_by_others(
    link: ForkServerLink, start: Callable[..., ForkedChild]
) -> None:
    first, second = start(), start()
    assert [psutil.Process(child.pid).ppid() for child in (first, second)] == [link.pid] * 2
    first.kill()
    assert first.end(PATIENCE_S) == "killed by SIGKILL"
    assert not has_died(second)


def test_without_their_fork_server_processes_live_on_and_the_next_gets_another(
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


def test_a_fork_server_that_answers_no_more_makes_room_for_another(
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


def test_where_no_more_pipes_can_be_had_none_is_kept(
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


def test_stopped_it_forks_no_more_and_ends_after_the_last_of_its_processes(
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


def test_when_the_gateway_is_killed_all_end(tmp_path: Path) -> None:
    command = [sys.executable, "-c", GATEWAY, json.dumps(FORK_SERVER), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, text=True) as gateway:
        assert gateway.stdout is not None
        pids = [int(pid) for pid in gateway.stdout.readline().split()]
        assert len(pids) == 2
        assert not any(is_gone(pid) for pid in pids)
        gateway.kill()
    until(lambda: all(is_gone(pid) for pid in pids))


def test_who_waits_for_the_first_fork_is_told_when_there_will_be_none(tmp_path: Path) -> None:
    link = ForkServerLink((sys.executable, "-c", "import time; time.sleep(1000)"))  # it never comes to fork
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


def test_a_program_that_forks_nothing_is_told_of_and_tried_again(tmp_path: Path) -> None:
    link = ForkServerLink((sys.executable, "-c", "pass"))
    for _ in range(2):
        with pytest.raises(OSError):  # noqa: PT011  it may end before it is asked, or after
            link.start(tmp_path, {})
    link.stop()
    link.join(END_S)
