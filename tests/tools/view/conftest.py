"""A bridge to the client's fake server, and a page without a browser."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import AsyncIterator, Callable
from typing import Any

import numpy as np
import pytest

from motiongen_client import MotionClient
from motiongen_tools.view.access import Role
from motiongen_tools.view.bridge import Bridge
from motiongen_tools.view.browser import Browser
from motiongen_tools.view.line import Line
from motiongen_tools.view.room import Room
from tests.client.conftest import stick_motion, stick_rig
from tests.client.fake_server import FakeServer
from tests.waiting import LIMIT_S

__all__ = ["stick_motion", "stick_rig"]


class Page:
    """A page and what it has received. `ask` sends a request and waits for its answer. The bridge sends in beats."""

    def __init__(self) -> None:
        self.messages: list[dict[str, Any]] = []
        self.frames: list[tuple[dict[str, Any], np.ndarray]] = []
        self._said: asyncio.Queue[str] = asyncio.Queue()
        self._heard = asyncio.Event()
        self._requests = 0

    async def send_text(self, data: str) -> None:
        self.messages.append(json.loads(data, parse_constant=_no_browser_reads))
        self._heard.set()

    async def send_bytes(self, data: bytes) -> None:
        (length,) = struct.unpack_from("<I", data)
        self.frames.append((json.loads(data[4 : 4 + length]), np.frombuffer(data[4 + length :], "<f4")))
        self._heard.set()

    async def receive_text(self) -> str:
        return await self._said.get()

    def say(self, text: str) -> None:
        self._said.put_nowait(text)

    async def until(self, found: Any) -> Any:
        """Wait for the first true value that `found` returns."""
        async with asyncio.timeout(LIMIT_S):
            while not (result := found()):
                self._heard.clear()
                await self._heard.wait()
        return result

    async def ask(self, **message: Any) -> dict[str, Any]:
        self._requests += 1
        request = self._requests
        self.say(json.dumps({**message, "request": request}))
        return await self.until(
            lambda: next((m for m in self.messages if m["type"] == "answer" and m["request"] == request), None)
        )

    def last(self, kind: str) -> dict[str, Any] | None:
        return next((m for m in reversed(self.messages) if m["type"] == kind), None)


def _no_browser_reads(constant: str) -> None:
    raise ValueError(f"{constant} is no JSON, though Python writes and reads it")


async def beats_until(bridge: Bridge, condition: Callable[[], bool]) -> None:
    """Let a running bridge beat until a condition holds."""
    async with asyncio.timeout(LIMIT_S):
        while not condition():
            await bridge.beat()


@pytest.fixture
async def bridge(server: FakeServer) -> AsyncIterator[Bridge]:
    """A running bridge that has received the catalogue."""
    bridge = Bridge(Line(lambda: MotionClient(server.address)))
    running = asyncio.create_task(bridge.run())
    await beats_until(bridge, lambda: bridge.line.has_catalog)
    yield bridge
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


@pytest.fixture
async def room(bridge: Bridge) -> Room:
    return bridge.room("main")


@pytest.fixture
async def page(bridge: Bridge, room: Room) -> AsyncIterator[Page]:
    """A page with the role CONTROL."""
    page = Page()
    serving = asyncio.create_task(Browser(page, bridge, room, Role.CONTROL).serve())
    yield page
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)
