"""The C++ client and a real server: unit tests, examples, the C interface, edits and lost connections."""

from __future__ import annotations

import os
import re
import subprocess
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from motiongen_tools.server_process import ServerProcess
from tests.conftest import TINY_MODEL, LiveServer
from tests.cpp.building import SOURCE, run
from tests.cpp.proxy import BlockingLine
from tests.waiting import LIMIT_S

Program = Callable[[str], Path]
PATIENCE_S = 200.0
NOTICES_SILENCE = {"MOTIONGEN_PING_S": "0.4"}  # a connection without pongs for about a second is given up


def test_unit_tests_of_the_client_pass(program: Program, tmp_path: Path) -> None:
    subprocess.run([program("client_parts_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path)


def test_stream_tests_pass_with_a_real_server(program: Program, live_server: LiveServer, tmp_path: Path) -> None:
    environment = {**os.environ, "MOTIONGEN_ADDRESS": live_server.address}
    subprocess.run([program("stream_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path, env=environment)


def test_a_hundred_connects_leak_no_memory(program: Program, live_server: LiveServer) -> None:
    told = subprocess.run(
        [program("connects"), live_server.address, "100"], check=True, stdout=subprocess.PIPE, text=True
    )
    settled_kb, last_kb = map(int, told.stdout.split())
    assert last_kb - settled_kb < 4096


@pytest.mark.parametrize("example", ["one_character", "crowd ADDRESS 20 2", "from_c"])
def test_example_runs_with_a_real_server(program: Program, live_server: LiveServer, example: str) -> None:
    name, *arguments = example.replace("ADDRESS", live_server.address).split()
    command = [program(name), *(arguments or [live_server.address])]
    assert subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


@pytest.mark.parametrize("size", [["0"], ["20", "0"], ["many"]])
def test_crowd_example_refuses_an_invalid_size_or_duration(program: Program, size: list[str]) -> None:
    assert subprocess.run([program("crowd"), "localhost:1", *size], stderr=subprocess.DEVNULL).returncode == 2


def test_unit_tests_of_the_c_interface_pass(program: Program, tmp_path: Path) -> None:
    subprocess.run([program("c_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path)


def test_stream_tests_of_the_c_interface_pass_with_a_real_server(
    program: Program, live_server: LiveServer, tmp_path: Path
) -> None:
    environment = {**os.environ, "MOTIONGEN_ADDRESS": live_server.address}
    subprocess.run([program("c_stream_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path, env=environment)


def test_c_library_exports_exactly_the_declared_functions(program: Program) -> None:
    library = program("c_tests").parents[1] / "libmotiongen_c.so"
    listing = run("nm", "--dynamic", "--defined-only", library)
    names = {line.split()[2] for line in listing.splitlines()}
    headers = (SOURCE / "include" / "motiongen" / "c").glob("*.h")
    text = "".join(header.read_text(encoding="utf-8") for header in headers)
    declared = re.findall(r"^MOTIONGEN_C_API .*?(motiongen_\w+)\(", text, re.MULTILINE)
    assert names == set(declared)


@pytest.mark.parametrize("compiler", ["gcc -x c -std=c99 -Wstrict-prototypes", "g++ -x c++ -std=c++17"])
def test_each_header_of_the_c_interface_compiles_alone(compiler: str) -> None:
    command = [*compiler.split(), "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only", "-I", SOURCE / "include"]
    headers = sorted((SOURCE / "include").rglob("*.h"))
    assert len(headers) > 5
    for header in headers:
        run(*command, header)


class Character:
    """A running `told_events`: it takes commands as lines, and prints a line for each thing that happens."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.heard: list[list[str]] = []  # all lines so far

    def tell(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def hear(self, kind: str) -> list[str]:
        """The words of the next line of a kind. Fails if the session or the program ends before it comes."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            words = line.split()
            self.heard.append(words)
            if words[0] == kind:
                return words
            assert words[0] != "closed", f"the session ended before it printed {kind!r}: {line}"
        raise AssertionError(f"the program ended without printing {kind!r}")

    def hear_each(self, *kinds: str) -> None:
        """Wait for a line of each kind given, in any order."""
        missing = Counter(kinds)
        while missing.total():
            assert self._process.stdout is not None
            words = self._process.stdout.readline().split()
            assert words, f"the program ended without printing {dict(missing)}"
            assert words[0] != "closed", f"the session ended before it printed {dict(missing)}"
            self.heard.append(words)
            missing -= Counter([words[0]])

    def place(self, frame: int) -> tuple[float, ...]:
        self.tell(f"x {frame}")
        return tuple(map(float, self.hear("x")[2:]))


@contextmanager
def character(program: Program, address: str, **variables: str) -> Iterator[Character]:
    """variables: environment variables that the program connects with, MOTIONGEN_TOKEN and others.

    By default it pings so rarely that silence ends no connection, since a busy machine stalls for a second now and
    then: connections are lost only when a test cuts them.
    """
    command = [str(program("told_events")), address]
    environment = {**os.environ, "MOTIONGEN_PING_S": "60", **variables}
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdin is not None
    assert process.stdout is not None
    patience = threading.Timer(PATIENCE_S, process.kill)  # so that no test waits for ever for a line that never comes
    patience.start()
    with process.stdout, process.stdin:
        try:
            yield Character(process)
            process.stdin.write("quit\n")
            process.stdin.flush()
            assert process.wait(LIMIT_S) == 0
        finally:
            patience.cancel()
            process.kill()
            process.wait()


def test_session_is_resumed_exactly_after_a_lost_connection(program: Program, live_server: LiveServer) -> None:
    with BlockingLine(live_server.address) as proxy, character(program, proxy.address) as walker:
        walker.hear("opened")
        walker.tell("waypoint 400 1 2")
        assert walker.hear("edit")[2] == "OK"
        walker.tell("wait 20")
        walker.hear("frame")
        before = walker.place(0)
        proxy.cut()
        assert walker.hear("lost")[1] == "UNAVAILABLE"
        walker.tell("prompt a person runs forward")  # while there is no stream
        walker.hear("connected")
        _, first, exact = walker.hear("recovered")
        assert exact == "1"
        assert walker.hear("edit")[1:3] == ["2", "OK"]
        walker.tell(f"wait {int(first) + 4}")
        assert walker.hear("frame")[2] == "OK"
        assert walker.place(0) == before


def test_every_edit_is_answered_once_although_connections_are_lost(program: Program, live_server: LiveServer) -> None:
    with BlockingLine(live_server.address) as proxy, character(program, proxy.address) as walker:
        walker.hear("opened")
        for number in range(1, 11):
            walker.tell(f"prompt a person does number {number}")
            if number % 2:
                proxy.cut()
            assert walker.hear("edit")[1:3] == [str(number), "OK"]


def test_session_that_the_server_did_not_keep_is_reopened(program: Program) -> None:
    settings = ["--resume-grace-s", "0", "--model", str(TINY_MODEL), "--text-encoder", "hashed", "--devices", "cpu:1"]
    settings += ["--profile-s", "0.3", "--admit-load", "1000", "--degrade", "false"]
    with (
        ServerProcess(settings) as server,
        BlockingLine(server.address) as proxy,
        character(program, proxy.address) as walker,
    ):
        walker.tell("wait 20")
        walker.hear("frame")
        walker.tell("waypoint 400 1 2")
        assert walker.hear("edit")[2] == "OK"
        proxy.cut()
        walker.hear("lost")
        walker.tell("prompt a person runs forward")
        _, first, exact = walker.hear("recovered")
        assert exact == "0"
        assert int(first) > 20, "held frames are played before new ones"
        assert walker.hear("edit")[1:3] == ["2", "OK"]
        walker.tell(f"wait {int(first) + 4}")
        assert walker.hear("frame")[2] == "OK"


def test_paused_session_that_was_never_played_is_recovered(program: Program, live_server: LiveServer) -> None:
    with BlockingLine(live_server.address) as proxy, character(program, proxy.address) as walker:
        walker.tell("pause")
        assert walker.hear("edit")[2] == "OK"
        for _ in range(3):
            proxy.cut()
            walker.hear("lost")
            walker.hear("recovered")
        walker.tell("prompt a person waves")
        assert walker.hear("edit")[2] == "OK"


def test_frozen_connection_is_detected_and_the_session_recovers(program: Program, live_server: LiveServer) -> None:
    with (
        BlockingLine(live_server.address) as proxy,
        character(program, proxy.address, **NOTICES_SILENCE) as walker,
    ):
        walker.tell("wait 4")
        walker.hear("frame")
        proxy.freeze()
        walker.hear("lost")
        proxy.thaw()
        walker.hear("recovered")
