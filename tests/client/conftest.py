"""Fixtures: one or two fake servers for each test, a clock that the test moves, and motions made by formula."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator

import pytest

from motiongen_client import Motion, MotionClient, Rig, convert
from tests.client.fake_server import FakeServer
from tests.client.synthetic import rig, synthetic_rows


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer(replica_id="first") as running:
        yield running


@pytest.fixture
def other() -> Iterator[FakeServer]:
    """A second server."""
    with FakeServer(replica_id="other") as running:
        yield running


class ManualClock:
    """The clock of an event loop: sleeps end and frames are due when the test advances it, however slow the machine."""

    def __init__(self, now_s: float) -> None:
        self.now_s = now_s

    def advance(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture
async def clock(monkeypatch: pytest.MonkeyPatch) -> ManualClock:
    """The clock of the test's event loop. Request it before any fixture that reads the time."""
    loop = asyncio.get_running_loop()
    clock = ManualClock(loop.time())
    monkeypatch.setattr(loop, "time", lambda: clock.now_s)
    return clock


@pytest.fixture
async def client(server: FakeServer) -> AsyncIterator[MotionClient]:
    async with MotionClient(server.address) as connected:
        yield connected


@pytest.fixture
def stick_rig() -> Rig:
    return convert.rig(rig(20))


@pytest.fixture
def stick_motion(stick_rig: Rig) -> Motion:
    """Two seconds from frame 0."""
    return Motion(stick_rig, 0, synthetic_rows(1, 0, 40))
