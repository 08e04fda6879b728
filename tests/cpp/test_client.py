"""The C++ client and a real server: streams, edits, threads, and what is lost on the way."""

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
NOTICES_SILENCE = {"MOTIONGEN_PING_S": "0.4"}  # a server that says nothing for a second is given up


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


@pytest.mark.parametrize("example", ["one_character", "crowd ADDRESS 20 2", "from_c"])
def test_an_example_runs(program: Program, live_server: LiveServer, example: str) -> None:
    name, *arguments = example.replace("ADDRESS", live_server.address).split()
    command = [program(name), *(arguments or [live_server.address])]
    assert subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


@pytest.mark.parametrize("size", [["0"], ["20", "0"], ["many"]])
def test_a_crowd_of_nobody_or_for_no_time_is_refused(program: Program, size: list[str]) -> None:
    assert subprocess.run([program("crowd"), "localhost:1", *size], stderr=subprocess.DEVNULL).returncode == 2


def test_the_c_interface_passes_its_unit_tests(program: Program, tmp_path: Path) -> None:
    subprocess.run([program("c_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path)


def test_the_c_interface_on_a_real_server(program: Program, live_server: LiveServer, tmp_path: Path) -> None:
    environment = {**os.environ, "MOTIONGEN_ADDRESS": live_server.address}
    subprocess.run([program("c_stream_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path, env=environment)


def test_the_library_for_engines_shows_its_c_interface_alone(program: Program) -> None:
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
    """`told_events` at work: told lines, and telling what happens."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.heard: list[list[str]] = []  # all lines so far

    def tell(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def hear(self, kind: str) -> list[str]:
        """The words of the next line of a kind. Fails where the session or the program ends before it comes."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            words = line.split()
            self.heard.append(words)
            if words[0] == kind:
                return words
            assert words[0] != "closed", f"the session ended before it told {kind!r}: {line}"
        raise AssertionError(f"the program ended without telling {kind!r}")

    def hear_each(self, *kinds: str) -> None:
        """As many lines of each kind, in whichever order they come."""
        missing = Counter(kinds)
        while missing.total():
            assert self._process.stdout is not None
            words = self._process.stdout.readline().split()
            assert words, f"the program ended without telling {dict(missing)}"
            assert words[0] != "closed", f"the session ended before it told {dict(missing)}"
            self.heard.append(words)
            missing -= Counter([words[0]])

    def place(self, frame: int) -> tuple[float, ...]:
        self.tell(f"x {frame}")
        return tuple(map(float, self.hear("x")[2:]))


@contextmanager
def character(program: Program, address: str, **variables: str) -> Iterator[Character]:
    """variables: what the program connects with, MOTIONGEN_TOKEN and others.

    It gives nobody up for silence unless it is told to: a busy machine is silent for a second now and then, and lines
    are lost when a test loses them.
    """
    command = [str(program("told_events")), address]
    environment = {**os.environ, "MOTIONGEN_PING_S": "60", **variables}
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdin is not None
    assert process.stdout is not None
    patience = threading.Timer(PATIENCE_S, process.kill)  # else who waits for a line that never comes waits for ever
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


def test_a_character_goes_on_after_a_cut_as_if_nothing_had_been(program: Program, live_server: LiveServer) -> None:
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


def test_each_edit_is_answered_once_however_often_the_stream_is_cut(program: Program, live_server: LiveServer) -> None:
    with BlockingLine(live_server.address) as proxy, character(program, proxy.address) as walker:
        walker.hear("opened")
        for number in range(1, 11):
            walker.tell(f"prompt a person does number {number}")
            if number % 2:
                proxy.cut()
            assert walker.hear("edit")[1:3] == [str(number), "OK"]


def test_a_character_is_opened_anew_where_it_was_not_kept(program: Program) -> None:
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
        assert int(first) > 20, "what was held is played before what comes anew"
        assert walker.hear("edit")[1:3] == ["2", "OK"]
        walker.tell(f"wait {int(first) + 4}")
        assert walker.hear("frame")[2] == "OK"


def test_a_paused_character_that_was_never_played_is_recovered_too(program: Program, live_server: LiveServer) -> None:
    with BlockingLine(live_server.address) as proxy, character(program, proxy.address) as walker:
        walker.tell("pause")
        assert walker.hear("edit")[2] == "OK"
        for _ in range(3):
            proxy.cut()
            walker.hear("lost")
            walker.hear("recovered")
        walker.tell("prompt a person waves")
        assert walker.hear("edit")[2] == "OK"


def test_a_server_that_freezes_is_noticed(program: Program, live_server: LiveServer) -> None:
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
