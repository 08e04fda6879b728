"""One call of the load against something that takes connections and says nothing."""

from __future__ import annotations

import asyncio
import socket
import time

import pytest

from motiongen_client.errors import ServerUnavailable
from motiongen_tools.bench import stream_client
from motiongen_tools.bench.recorder import Recorder
from motiongen_tools.bench.stream_client import StreamClient
from tests.waiting import LIMIT_S


async def test_a_server_that_says_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_client, "_CONNECT_TIMEOUT_S", 0.1)
    monkeypatch.setattr(stream_client, "_HELLO_TIMEOUT_S", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        client = StreamClient(address, 1 << 20, time.monotonic, Recorder(("crowd",), 1))
        async with asyncio.timeout(LIMIT_S):
            with pytest.raises(ServerUnavailable, match="no hello came"):
                await client.start()
