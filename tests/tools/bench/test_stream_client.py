"""One stream of the load generator, against a silent server and a newer one."""

from __future__ import annotations

import asyncio
import math
import socket
import time

import pytest

from motiongen.v1 import session_pb2
from motiongen_client.errors import ServerUnavailable
from motiongen_tools.bench import stream_client
from motiongen_tools.bench.character import Character, make_jitter
from motiongen_tools.bench.recorder import Recorder
from motiongen_tools.bench.schedule import CharacterPlan, Phases
from motiongen_tools.bench.stream_client import StreamClient
from tests.client.fake_server import FakeServer
from tests.client.waiting import until
from tests.waiting import LIMIT_S


async def test_a_silent_server_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_client, "_CONNECT_TIMEOUT_S", 0.1)
    monkeypatch.setattr(stream_client, "_HELLO_TIMEOUT_S", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        client = StreamClient(address, 1 << 20, time.monotonic, Recorder(("crowd",), 1))
        async with asyncio.timeout(LIMIT_S):
            with pytest.raises(ServerUnavailable, match="no hello came"):
                await client.start()


async def test_unknown_tiers_and_reasons_are_counted_by_their_number_and_lose_no_stream(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stream_client, "_CLOSE_GRACE_S", LIMIT_S)
    recorder = Recorder(("crowd",), 1)
    plan, phases = CharacterPlan(0, 0, 0.0, math.inf, 5, 0), Phases(0.0, 0, 1, 1.0)
    character = Character(1, plan, "crowd", fps=20, jitter=make_jitter(), phases=phases, recorder=recorder)
    with FakeServer() as server:
        client = StreamClient(server.address, 1 << 20, time.monotonic, recorder)
        client.adopt([(character, "crowd")])
        await client.start()
        level = session_pb2.ServiceLevel(denoise_steps=3)
        level.tier = 9  # type: ignore[assignment]  # of a later version
        closed = session_pb2.SessionClosed()
        closed.reason = 99  # type: ignore[assignment]  # of a later version
        server.stream.push(1, service_level=level)
        server.stream.push(1, closed=closed)
        await until(lambda: recorder.counts["sessions_lost: 99"])
        await client.stop()
    assert recorder.counts["service level: 9, 3 steps"] == 1
    assert client.lost == "the server ended the stream", "as it was asked to, after which nothing was read"
    assert recorder.counts["streams_lost"] == 0
