"""Frames that the C++ client takes sooner than they would be shown: later edits take effect after them."""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_tools.server_process import ServerProcess
from tests.client.fake_server import LEAD, FakeServer
from tests.client.synthetic import LOOKAHEAD
from tests.conftest import TINY_MODEL
from tests.cpp.test_client import Character, character
from tests.waiting import LIMIT_S

Program = Callable[[str], Path]
COMMITTED = 4  # frames that the fake server commits before its first report of a playhead


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer() as running:
        yield running


class Answers:
    """Holds back the server's answers to velocities until `let_go`."""

    def __init__(self, server: FakeServer) -> None:
        self._may_go = threading.Event()
        server.refuse = self._hold

    def _hold(self, event: session_pb2.SessionEvent) -> str:
        if event.HasField("set_velocity"):
            assert self._may_go.wait(LIMIT_S)
        return ""

    def let_go(self) -> None:
        self._may_go.set()


def go_to(walker: Character, frame: int) -> str:
    walker.tell(f"to {frame}")
    return walker.hear("at")[2]


def has_no_late_plan(walker: Character) -> bool:
    walker.tell("stats")
    return walker.hear("stats")[3] == "0"


def test_frames_that_an_unanswered_edit_may_replace_are_not_shown(program: Program, server: FakeServer) -> None:
    answers = Answers(server)
    with character(program, server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell(f"wait {LOOKAHEAD - 1}")
        walker.hear("frame")
        walker.tell("velocity 1 0")
        shown = [go_to(walker, COMMITTED - 1), go_to(walker, COMMITTED), go_to(walker, LOOKAHEAD - 1)]
        answers.let_go()
        assert shown == ["OK", "EDIT_UNANSWERED", "EDIT_UNANSWERED"]
        assert walker.hear("edit")[2:4] == ["OK", str(LEAD)]
        assert go_to(walker, LEAD) == "OK"
        assert has_no_late_plan(walker)


def test_waiting_for_a_frame_waits_for_unanswered_edits_too(program: Program, server: FakeServer) -> None:
    answers = Answers(server)
    with character(program, server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell(f"wait {LOOKAHEAD - 1}")
        walker.hear("frame")
        walker.tell("velocity 1 0")
        walker.tell(f"wait {LOOKAHEAD - 1}")
        walker.tell(f"to {LOOKAHEAD - 1}")
        answers.let_go()
        walker.hear_each("edit", "at")
        assert ["at", str(LOOKAHEAD - 1), "OK"] in walker.heard
        assert has_no_late_plan(walker)


@pytest.mark.parametrize("taken", [LEAD + 10, LOOKAHEAD - 1])
def test_edit_takes_effect_after_the_frames_that_were_taken(program: Program, server: FakeServer, taken: int) -> None:
    with character(program, server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell(f"wait {taken}")
        walker.hear("frame")
        assert go_to(walker, taken) == "OK"
        walker.tell("velocity 1 0")
        _, _, code, effective = walker.hear("edit")[:4]
        assert code == "OK"
        assert int(effective) > taken
        walker.tell(f"wait {effective}")
        assert walker.hear("frame")[2] == "OK"
        assert has_no_late_plan(walker)
    told = [event.WhichOneof("event") for event in server.stream.received]
    at = told.index("set_velocity")
    assert told[at - 1] == "playhead"
    assert server.stream.received[at - 1].playhead.frame == taken


def test_a_server_in_real_time_replaces_no_frame_that_was_taken(program: Program, tmp_path: Path) -> None:
    """The server of the other tests allows for clients that play a thousand times faster than real time."""
    settings = ["--model", str(TINY_MODEL), "--text-encoder", "hashed", "--devices", "cpu:1"]
    settings += ["--profile-s", "0.3", "--admit-load", "1000", "--degrade", "false"]
    test = "--gtest_filter=Stream.EditsWhileFramesAreTakenAsTheyComeReplaceNoTakenFrame"
    with ServerProcess(settings) as server:
        environment = {**os.environ, "MOTIONGEN_ADDRESS": server.address}
        subprocess.run([program("stream_tests"), "--gtest_brief=1", test], check=True, cwd=tmp_path, env=environment)
