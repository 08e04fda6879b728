"""The C++ client and a real server: streams, edits, threads, and what is lost on the way."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.conftest import LiveServer
from tests.cpp.proxy import TcpProxy

Program = Callable[[str], Path]


def test_the_parts_of_the_client_pass_their_unit_tests(program: Program, tmp_path: Path) -> None:
    subprocess.run([program("client_parts_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path)


def test_streams_on_a_real_server(program: Program, live_server: LiveServer, tmp_path: Path) -> None:
    environment = {**os.environ, "MOTIONGEN_ADDRESS": live_server.address}
    subprocess.run([program("stream_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path, env=environment)


def test_a_hundred_connects_leave_no_memory_behind(program: Program, live_server: LiveServer) -> None:
    told = subprocess.run(
        [program("connects"), live_server.address, "100"], check=True, stdout=subprocess.PIPE, text=True
    )
    settled_kb, last_kb = map(int, told.stdout.split())
    assert last_kb - settled_kb < 4096


@pytest.mark.parametrize("example", ["one_character"])
def test_an_example_runs(program: Program, live_server: LiveServer, example: str) -> None:
    done = subprocess.run([program(example), live_server.address], check=True, stdout=subprocess.PIPE, text=True)
    assert done.stdout.strip()


class Character:
    """`told_events` at work: told lines, and telling what happens."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def tell(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def hear(self, kind: str) -> list[str]:
        """The words of the next line of a kind; the program ends where none comes."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.split()[0] == kind:
                return line.split()
        raise AssertionError(f"the program ended without telling {kind!r}")

    def place(self, frame: int) -> tuple[float, ...]:
        self.tell(f"x {frame}")
        return tuple(map(float, self.hear("x")[2:]))


@contextmanager
def character(program: Program, address: str) -> Iterator[Character]:
    command = [str(program("told_events")), address]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdout, process.stdin:
        try:
            yield Character(process)
            process.stdin.write("quit\n")
            process.stdin.flush()
            assert process.wait(60) == 0
        finally:
            process.kill()
            process.wait()


def test_a_character_outlives_a_cut_connection(program: Program, live_server: LiveServer) -> None:
    with TcpProxy(live_server.address) as proxy, character(program, proxy.address) as walker:
        walker.hear("opened")
        walker.tell("waypoint 400 1 2")
        assert walker.hear("edit")[2] == "OK"
        walker.tell("wait 20")
        walker.hear("frame")
        before = walker.place(10)
        proxy.cut()
        assert walker.hear("lost")[1] == "UNAVAILABLE"
        walker.tell("prompt a person runs forward")  # while there is no stream
        walker.hear("connected")
        first = int(walker.hear("recovered")[1])
        assert first > 20, "what was held is played before what comes anew"
        assert walker.hear("edit")[1:3] == ["2", "OK"]
        walker.tell(f"wait {first + 4}")
        assert walker.hear("frame")[2] == "OK"
        assert walker.place(10) == before
        places = [walker.place(frame) for frame in range(first - 15, first + 1)]
        steps = [math.dist(*pair) for pair in itertools.pairwise(places)]
        assert steps[-1] < 3 * max(steps[:-1]), "it goes on from where it was"


def test_a_paused_character_that_was_never_played_is_recovered_too(program: Program, live_server: LiveServer) -> None:
    with TcpProxy(live_server.address) as proxy, character(program, proxy.address) as walker:
        walker.tell("pause")
        assert walker.hear("edit")[2] == "OK"
        for _ in range(3):
            proxy.cut()
            walker.hear("lost")
            walker.hear("recovered")
        walker.tell("prompt a person waves")
        assert walker.hear("edit")[2] == "OK"


def test_a_server_that_freezes_is_noticed(program: Program, live_server: LiveServer) -> None:
    with TcpProxy(live_server.address) as proxy, character(program, proxy.address) as walker:
        walker.tell("wait 4")
        walker.hear("frame")
        proxy.freeze()
        walker.hear("lost")
        proxy.thaw()
        walker.hear("recovered")
