"""Streams to other servers that are disconnected when they are needed again: no caller waits for them for ever."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import AsyncIterator

import grpc
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import EventRefused, LinePolicy, MotionClient
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer, full
from tests.client.waiting import until


@pytest.fixture
async def client(server: FakeServer) -> AsyncIterator[MotionClient]:
    """A client that may follow any address."""
    async with MotionClient(server.address, other_addresses=lambda _: True) as connected:
        yield connected


async def test_idle_stream_that_the_other_server_ended_is_reconnected_when_needed(
    client: MotionClient, server: FakeServer, other: FakeServer
) -> None:
    home = await client.open("walk")
    server.refuse = full((other.address, ""))
    await (await client.open("walk")).close()
    other.stream.fail(grpc.StatusCode.DEADLINE_EXCEEDED)
    (begun,) = client._elsewhere._streams.values()
    await until(lambda: not begun.result().is_connected)
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)
    await until(lambda: home.stats.reopenings == 1)
    assert (len(other.streams), len(other.stream.characters)) == (2, 1)


async def test_session_adopted_by_a_disconnected_stream_makes_it_connect(
    client: MotionClient, other: FakeServer
) -> None:
    session = await client.open("walk")
    own, taker = client._own_stream, client._stream(other.address, "")
    assert own is not None
    await taker.start()
    other.stream.fail(grpc.StatusCode.DEADLINE_EXCEEDED)
    await until(lambda: not taker.is_connected)
    own.release(session)
    session.interrupt()
    taker.adopt(session)
    await until(lambda: session.stats.reopenings == 1)
    assert len(other.stream.characters) == 1


@pytest.fixture
async def gone(client: MotionClient, server: FakeServer) -> str:
    """The address of a server that has stopped, to which the client has a stream."""
    with FakeServer(replica_id="gone") as leaving:
        server.refuse = full((leaving.address, ""))
        await (await client.open("walk")).close()
    return leaving.address


async def open_past_the_hello_timeout(client: MotionClient, clock: ManualClock) -> asyncio.Task[object]:
    """An opening that has waited longer than hello_timeout_s for the one stream to another server."""
    (begun,) = client._elsewhere._streams.values()
    calls = begun.result()._calls
    await until(lambda: not calls.is_connected)
    opening: asyncio.Task[object] = asyncio.create_task(client.open("walk"))
    await until(calls._wanted.is_set)
    clock.advance(LinePolicy().hello_timeout_s + 1)
    return opening


async def test_open_raises_the_refusal_when_the_other_server_is_gone(
    clock: ManualClock, client: MotionClient, gone: str
) -> None:
    opening = await open_past_the_hello_timeout(client, clock)
    with pytest.raises(EventRefused, match="OVERLOADED"):
        await opening


async def test_other_server_that_is_gone_is_skipped_for_the_next(
    clock: ManualClock, client: MotionClient, server: FakeServer, other: FakeServer, gone: str
) -> None:
    server.refuse = full((gone, ""), (other.address, ""))
    await (await open_past_the_hello_timeout(client, clock))
    assert other.stream.characters


async def test_session_waits_for_its_own_server_when_another_cannot_be_called(
    clock: ManualClock, server: FakeServer, other: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    refused = threading.Event()
    refuse = full((other.address, ""))

    def refuse_once(event: session_pb2.SessionEvent) -> str | session_pb2.EditOutcome:
        if not event.HasField("open") or refused.is_set():
            return ""
        refused.set()
        return refuse(event)

    def token() -> str:
        if refused.is_set():
            raise ConnectionError("the issuer does not answer")
        return "secret"

    async with MotionClient(server.address, token=token, other_addresses=[other.address]) as client:
        session = await client.open("walk")
        server.refuse = refuse_once
        with caplog.at_level(logging.WARNING, "motiongen_client"):
            server.stream.fail(grpc.StatusCode.UNAVAILABLE)
            await until(lambda: client._own_stream is not None and not client._own_stream.is_connected)
            for _ in range(2):
                await asyncio.sleep(0)  # until its delay has begun
            clock.advance(0.5)
            await until(lambda: client._elsewhere._moving)
            await until(lambda: not client._elsewhere._moving)
        assert "cannot go on at another server: the issuer does not answer" in caplog.text
        clock.advance(3600)  # the delay that the server asked for
        await until(lambda: session.stats.reopenings == 1)
        assert (len(server.streams), other.streams) == (2, [])
