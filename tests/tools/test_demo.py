"""The demo's verdict and its files, with the fake server; tests/e2e has the real one."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_tools.cli import run
from motiongen_tools.demo.script import CAST, STORY_S, GoTo, Move, Say
from tests.client.fake_server import FakeServer


@pytest.fixture
def slow_server() -> Iterator[FakeServer]:
    """A server at the built-in model's frame rate: what is shown does not wait for real time."""
    with FakeServer(frame_rate=20) as running:
        yield running


async def demo(server: FakeServer, out: Path, *more: str) -> int:
    return await asyncio.to_thread(run, ["demo", "--server", server.address, "--out", str(out), *more])


async def test_the_whole_script_is_played_written_drawn_and_measured(
    slow_server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert await demo(slow_server, tmp_path, "--bound", "100") == 0
    names = sorted(os.listdir(tmp_path))
    bvh = [f"{number}-{role.name}.bvh" for number, role in enumerate(CAST, 1)]
    assert names == sorted([*bvh, "contact_sheet.png", "contact_sheet_beside.png"])
    printed = capsys.readouterr().out
    assert f"{len(CAST) * round(STORY_S * 20)} frames" in printed
    assert "came too late for the playhead: 0" in printed
    kinds = [event.WhichOneof("event") for event in slow_server.stream.received]
    actions = [action for role in CAST for cue in role.cues for action in cue.actions]
    assert kinds.count("open") == len(CAST)
    assert kinds.count("set_velocity") == sum(isinstance(action, Move) for action in actions)
    assert kinds.count("edit_prompts") == sum(isinstance(action, Say) for action in actions) + 1  # the circle's
    assert len(slow_server.streams) == 1


async def test_a_missed_waypoint_fails_the_demo(
    slow_server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The fake server's characters ignore all events: they go 1 m/s along +Z."""
    assert await demo(slow_server, tmp_path, "--bound", "0.3", "--seconds", "10.5") == 1
    problems = [line for line in capsys.readouterr().out.splitlines() if line.startswith("problem: ")]
    num_places = sum(isinstance(action, GoTo) for role in CAST for cue in role.cues for action in cue.actions)
    assert 1 <= sum(line.startswith("problem: story: ") for line in problems) <= num_places
    assert all("missed by" in line and "more than 30" in line for line in problems)


async def test_goals_that_are_not_due_yet_are_not_missed(slow_server: FakeServer, tmp_path: Path) -> None:
    assert await demo(slow_server, tmp_path, "--seconds", "3") == 0


async def test_a_session_that_is_closed_fails_the_demo(
    slow_server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def end_of_the_third(event: session_pb2.SessionEvent) -> str:
        if event.WhichOneof("event") == "playhead" and event.session == 3:
            closed = session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_ENGINE_FAULT, code=13, message="broken")
            slow_server.stream.push(3, closed=closed)
        return ""

    slow_server.refuse = end_of_the_third
    assert await demo(slow_server, tmp_path, "--seconds", "2") == 1
    assert "problem: circle: the session has ended (engine_fault): broken" in capsys.readouterr().out


async def test_a_refused_cue_and_a_warning_are_reported(
    slow_server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(event: session_pb2.SessionEvent) -> str:
        slow_server.stream.warnings = [
            session_pb2.EventWarning(reason="PROMPT_OUTSIDE_DOMAIN", message="this is outside", field="prompts[0]")
        ]
        return "HOLD_OUT_OF_RANGE" if event.WhichOneof("event") == "set_velocity" and event.session == 2 else ""

    slow_server.refuse = refuse
    assert await demo(slow_server, tmp_path, "--seconds", "7") == 1
    printed = capsys.readouterr().out
    assert "problem: run: " in printed
    assert "HOLD_OUT_OF_RANGE" in printed
    assert "warning for outside: this is outside" in printed
