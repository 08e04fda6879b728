"""The client with statuses of the real server for calls that it refuses."""

from __future__ import annotations

from collections.abc import Iterator

import grpc
import pytest

from motiongen_client import LinePolicy, MotionClient, StreamLost, calls
from motiongen_server.errors import StreamRefused
from tests.client.fake_server import FakeServer
from tests.client.waiting import until


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer() as running:
        yield running


async def test_starting_server_is_retried_with_another_key(server: FakeServer) -> None:
    async with MotionClient(server.address) as client:
        session = await client.open("walk")
        starting = StreamRefused(grpc.StatusCode.UNAVAILABLE, "STARTING", "it loads").status()
        server.turned_away = [starting] * 100
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)
        await until(lambda: len({each["x-motiongen-key"] for each in server.metadata}) >= 3)
        server.turned_away = []
        await until(lambda: session.stats.reopenings == 1)
        await session.close()
    keys = [each["x-motiongen-key"] for each in server.metadata]
    assert keys[:3] == [keys[0]] * 3, "a server that was only lost may still have the session"
    assert len(set(keys[3:])) >= 2, "a starting server must not be asked for ever"


async def test_refusal_has_its_reason_however_soon_it_comes(server: FakeServer) -> None:
    full = StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "STREAM_LIMIT", "no more streams").status()
    async with MotionClient(server.address, policy=LinePolicy(recover_s=0)) as client:
        for _ in range(60):  # one in fifteen, sometimes one in three, comes while the hello is still being written
            server.turned_away = [full] * 100
            with pytest.raises(StreamLost) as refused:
                await client.open("walk")
            assert (refused.value.code, refused.value.reason) == ("RESOURCE_EXHAUSTED", "STREAM_LIMIT")


async def test_client_that_listens_before_the_hello_is_served(
    server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calls, "LISTEN_S", (0.05,))
    async with MotionClient(server.address) as client:
        session = await client.open("walk")
        assert await anext(session.frames(0.1, realtime=False))
