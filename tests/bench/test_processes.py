"""Measurements of a server cover all its processes, also engines that are forked from another process."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import psutil
import pytest

from tests.bench import engines, null_process
from tests.bench.processes import below, engines_of, memory_mib, memory_of

FORKS = """
import os, sys, time
if os.fork() == 0:  # the process that engines are forked from
    for _ in range(2):
        if os.fork() == 0:
            held, until = bytearray(40 << 20), time.process_time() + 0.1
            held[::4096] = b"x" * len(held[::4096])
            while time.process_time() < until:
                pass
            os.write(1, b"there\\n")  # in one write, since the other process writes too
            sys.stdin.read()
            os._exit(0)
    os.wait(), os.wait()
    os._exit(0)
os.wait()
"""


@pytest.fixture
def gateway() -> Iterator[psutil.Process]:
    """A process whose child has two children of its own, which have used 40 MiB and 0.1 s each."""
    with subprocess.Popen([sys.executable, "-c", FORKS], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for _ in range(2):
            assert process.stdout.readline() == b"there\n"
        yield psutil.Process(process.pid)
        process.stdin.close()


def test_engines_are_found_below_their_fork_server(gateway: psutil.Process) -> None:
    (fork_server,) = gateway.children()
    assert sorted(each.pid for each in below(gateway)) == sorted(
        each.pid for each in (fork_server, *fork_server.children())
    )
    assert {each.pid for each in engines_of(gateway)} == {each.pid for each in fork_server.children()}


def test_memory_and_cpu_time_are_those_of_all_processes(gateway: psutil.Process) -> None:
    memory = memory_mib(gateway)
    assert len(memory) == 4
    assert sum(each > 40 for each in memory) == 2
    server = engines.Server(gateway.pid, "nowhere")
    assert len(server.memory_mib()) == 4
    assert server.cpu_s() >= 0.2
    assert null_process.NullServer(gateway.pid, "nowhere", {}).cpu_s()["engine"] >= 0.2


def test_proportional_memory_lies_between_own_and_resident_memory(gateway: psutil.Process) -> None:
    found = [memory_of(each.pid) for each in (gateway, *below(gateway))]
    assert all(each.own <= each.proportional <= each.resident for each in found)
    assert sum(each.proportional for each in found) < sum(each.resident for each in found)
