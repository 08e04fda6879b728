"""The demo's judgement and its files, with the fake server; the real one is in tests/e2e."""

from __future__ import annotations

import asyncio
import math
import os
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_client import Motion
from motiongen_tools.cli import run
from motiongen_tools.demo import CAST, waypoint_ahead
from tests.client.fake_server import FakeServer


async def demo(server: FakeServer, out: Path) -> int:
    return await asyncio.to_thread(run, ["demo", "--server", server.address, "--seconds", "1.5", "--out", str(out)])


async def test_eight_characters_are_driven_written_and_measured(
    server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert await demo(server, tmp_path) == 0
    names = os.listdir(tmp_path)
    assert sum(name.endswith(".bvh") for name in names) == 8
    assert "contact_sheet.png" in names
    printed = capsys.readouterr().out
    assert all(role.name in printed for role in CAST)
    assert "of 2 events" in printed
    kinds = [event.WhichOneof("event") for event in server.stream.received]
    assert (kinds.count("open"), kinds.count("edit_prompts"), kinds.count("edit_constraints")) == (8, 1, 1)
    assert len(server.streams) == 1


async def test_a_character_that_gets_no_motion_fails_the_demo(
    server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def end_of_the_third(event: session_pb2.SessionEvent) -> str:
        if event.WhichOneof("event") == "playhead" and event.session == 3:
            closed = session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_ENGINE_FAULT, code=13, message="broken")
            server.stream.push(3, closed=closed)
        return ""

    server.refuse = end_of_the_third
    assert await demo(server, tmp_path) == 1
    printed = capsys.readouterr().out
    assert "problem: wave-right: the session has ended (engine_fault): broken" in printed


@pytest.mark.parametrize(("heading", "place"), [(0.0, (0.5, 5.0)), (math.pi / 2, (0.0, 4.5))])
def test_the_waypoint_is_where_the_walk_leads_and_half_a_metre_to_the_left(
    stick_motion: Motion, heading: float, place: tuple[float, float]
) -> None:
    """The stick figure moves 1 m/s along +Z, here facing along it or to its left, and has come to 1.95 m."""
    rows = stick_motion.rows.copy()
    rows[:, 0] = 0
    rows[:, 3:7] = [math.cos(heading / 2), 0, math.sin(heading / 2), 0]
    waypoint = waypoint_ahead(Motion(stick_motion.rig, 100, rows), 3.05)
    assert waypoint.frame == 139 + 61
    assert (waypoint.x_m, waypoint.z_m) == pytest.approx(place, abs=1e-4)
