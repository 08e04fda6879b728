"""What a client makes of a server's own words for a call that it turns away."""

from __future__ import annotations

from collections.abc import Iterator

import grpc
import pytest

from motiongen_client import MotionClient
from motiongen_server.errors import StreamRefused
from tests.client.fake_server import FakeServer
from tests.client.waiting import until


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer() as running:
        yield running


async def test_a_server_that_cannot_serve_yet_is_asked_by_another_key(server: FakeServer) -> None:
    async with MotionClient(server.address) as client:
        session = await client.open("walk")
        starting = StreamRefused(grpc.StatusCode.UNAVAILABLE, "STARTING", "it loads").status()
        server.turned_away = [starting, starting]
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)
        await until(lambda: session.stats.reopenings == 1)
        await session.close()
    keys = [each["x-motiongen-key"] for each in server.metadata]
    first, streams = keys[0], keys[1:6]
    assert streams[:2] == [first, first], "who was only lost may still have the session"
    assert len(set(streams[1:4])) == 3
