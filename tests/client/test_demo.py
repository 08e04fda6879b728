"""The demo's judgement and its files, with the fake server; the real one is in tests/e2e."""

from __future__ import annotations

import asyncio
import math
import os
from pathlib import Path

import numpy as np
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import Frame, Motion, convert
from motiongen_client.cli import run
from motiongen_client.demo import CAST, waypoint_ahead
from tests.client.fake_server import FakeServer, rig


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


@pytest.mark.parametrize(("heading", "place"), [(0.0, (0.5, 2.2)), (math.pi / 2, (2.2, -0.5))])
def test_the_waypoint_is_ahead_and_to_the_left(heading: float, place: tuple[float, float]) -> None:
    stick = convert.rig(rig(20))
    row = np.zeros((1, stick.row_width), np.float32)
    row[0, 3::4] = 1
    row[0, 3:7] = [math.cos(heading / 2), 0, math.sin(heading / 2), 0]
    row[0, :3] = [10, 0.9, 20]
    waypoint = waypoint_ahead(Frame(stick, 0, Motion(stick, 0, row).rows[0]), 50)
    assert (waypoint.x_m - 10, waypoint.z_m - 20) == pytest.approx(place, abs=1e-5)
