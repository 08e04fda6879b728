"""Callers that are cancelled, close a busy client or fail in a callback: others continue, and nothing is left over."""

from __future__ import annotations

import asyncio
import gc
import logging
import threading
from collections.abc import Iterator
from typing import Any

import grpc
import grpc.aio
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import LinePolicy, MotionClient, StreamLost
from motiongen_client.backlog import Backlog, SendQueue
from motiongen_client.call import CLOSE_GRACE_S, Call
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer
from tests.client.synthetic import HORIZON, catalog
from tests.client.waiting import received, until
from tests.waiting import LIMIT_S


async def test_cancelled_open_leaves_no_session_at_client_or_server(client: MotionClient, server: FakeServer) -> None:
    async with client.stream() as stream:
        opening = asyncio.create_task(stream.open("a person walks"))
        await until(lambda: stream.sessions)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        await received(server, "close")
        await until(lambda: not stream.sessions)
        assert not server.stream.characters
        assert (await stream.open("another")).opened.session_id


async def test_open_cancelled_while_disconnected_leaves_no_session(client: MotionClient, server: FakeServer) -> None:
    async with client.stream() as stream:
        server.refuse = lambda event: server.stream.fail(grpc.StatusCode.UNAVAILABLE) or ""  # type: ignore[func-returns-value]
        opening = asyncio.create_task(stream.open("a person walks"))
        await until(lambda: server.streams and server.stream.received and not stream.is_connected)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        assert stream.sessions == ()


async def test_server_is_asked_to_close_a_session_once_however_many_callers_close_it(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    given_up = asyncio.create_task(session.close())
    await asyncio.sleep(0)
    given_up.cancel()
    first, second = await asyncio.gather(session.close(), session.close())
    assert first is second
    await client.open("another")  # whatever was sent before has been received then
    assert [event.WhichOneof("event") for event in server.stream.received if event.event_seq] == [
        "open",
        "close",
        "open",
    ]


async def test_concurrent_opens_share_one_stream(client: MotionClient, server: FakeServer) -> None:
    sessions = await asyncio.gather(*(client.open(f"character {number}") for number in range(10)))
    assert len(server.streams) == 1
    assert sorted(session.handle for session in sessions) == list(range(1, 11))


async def test_cancelling_one_of_two_opens_leaves_the_stream_to_the_other(
    client: MotionClient, server: FakeServer
) -> None:
    first, second = (asyncio.create_task(client.open("walk")) for _ in range(2))
    await asyncio.sleep(0)
    first.cancel()
    assert (await second).handle
    assert first.cancelled()
    assert len(server.streams) == 1


async def test_client_forgets_streams_that_are_over(client: MotionClient) -> None:
    for _ in range(3):
        async with client.stream():
            pass
    async with client.stream() as last:
        assert client._streams == [last]


@pytest.mark.parametrize("policy", [LinePolicy(recover_s=0), LinePolicy(ping_s=0.01, pong_timeout_s=0.01, recover_s=0)])
async def test_streams_that_ended_for_good_leave_no_tasks_or_open_channels(
    server: FakeServer, monkeypatch: pytest.MonkeyPatch, policy: LinePolicy
) -> None:
    channels: list[grpc.aio.Channel] = []
    make = grpc.aio.insecure_channel

    def channel(*arguments: Any, **more: Any) -> grpc.aio.Channel:
        channels.append(make(*arguments, **more))
        return channels[-1]

    monkeypatch.setattr(grpc.aio, "insecure_channel", channel)
    async with MotionClient(server.address, policy=policy) as client:
        for _ in range(5):
            await client.open("walk")
            if policy.ping_s < 1:
                server.stream.answers_pings = False  # it is ended by its own check for pongs
            else:
                server.stream.fail(grpc.StatusCode.UNAVAILABLE)
            await until(lambda: client._own_stream is not None and client._own_stream.is_over)
    left = {task.get_name() for task in asyncio.all_tasks()}
    assert {name for name in left if name.startswith("motiongen-")} == set()
    assert len(channels) == 6
    assert {each.get_state() for each in channels} == {grpc.ChannelConnectivity.SHUTDOWN}


class Hanging(FakeServer):
    """Says hello, reads what a client writes, and never ends a stream. read_to_end: how many clients have finished."""

    read_to_end = 0

    def StreamMotion(
        self, request_iterator: Iterator[service_pb2.StreamMotionRequest], context: grpc.ServicerContext
    ) -> Iterator[service_pb2.StreamMotionResponse]:
        yield service_pb2.StreamMotionResponse(hello=service_pb2.ServerHello())
        gone = threading.Event()
        if context.add_callback(gone.set):
            for _ in request_iterator:
                pass
            self.read_to_end += 1
            gone.wait(LIMIT_S)


async def test_streams_of_servers_that_hang_are_closed_together(clock: ManualClock) -> None:
    with Hanging() as server:
        client = await MotionClient(server.address).connect()
        for _ in range(3):
            await client.stream().start()
        closing = asyncio.create_task(client.close())
        await until(lambda: server.read_to_end == 3)
        clock.advance(CLOSE_GRACE_S)
        await closing


async def test_opening_on_a_client_that_is_closed_raises_stream_lost(server: FakeServer) -> None:
    for turns in (1, 3, 9):
        client = await MotionClient(server.address).connect()
        opening = asyncio.create_task(client.open("walk"))
        for _ in range(turns):
            await asyncio.sleep(0)
        await client.close()
        with pytest.raises(StreamLost, match=r"closed"):
            await opening
    before = len(server.streams)
    with pytest.raises(StreamLost, match=r"the client is closed"):
        await client.open("walk")
    with pytest.raises(StreamLost, match=r"never connected"):
        await MotionClient(server.address).generate_clip("walk", num_frames=8)
    assert len(server.streams) == before


async def test_failure_of_a_stream_that_no_caller_awaits_is_not_reported_as_unhandled(server: FakeServer) -> None:
    said: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: said.append(context))
    client = await MotionClient(server.address).connect()
    opening = asyncio.create_task(client.open("walk"))
    await until(lambda: server.streams)
    opening.cancel()
    await client.close()
    with pytest.raises(asyncio.CancelledError):
        await opening
    assert not [task for task in asyncio.all_tasks() if task.get_name().startswith("motiongen-")]
    del client, opening
    gc.collect()
    assert said == []


async def test_cancelling_the_hello_exchange_leaves_no_task(server: FakeServer) -> None:
    channel = grpc.aio.insecure_channel(server.address)
    call = Call(channel, lambda response: None, lambda call, failure: None, SendQueue(Backlog(), lambda: 1 << 20))
    greeting = asyncio.create_task(call.greet("", server.address, LIMIT_S))
    await until(lambda: [task for task in asyncio.all_tasks() if task.get_name() == "motiongen-hello"])
    greeting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await greeting
    await call.close()
    await channel.close()
    assert not [task for task in asyncio.all_tasks() if task.get_name().startswith("motiongen-")]


async def test_second_connect_keeps_the_first_channel(server: FakeServer) -> None:
    async with await MotionClient(server.address).connect() as client:
        channel = client._channel
        assert await client.connect() is client
        assert client._channel is channel
    assert len(server.metadata) == 1


async def test_connect_waits_for_one_that_is_under_way(server: FakeServer) -> None:
    client = MotionClient(server.address)
    first, second = (asyncio.create_task(client.connect()) for _ in range(2))
    await second
    assert client.catalog.models
    await first
    await client.close()
    assert len(server.metadata) == 1


@pytest.fixture
def busy() -> Iterator[FakeServer]:
    """A server whose clips never end."""

    class Busy(FakeServer):
        def GetCatalog(
            self, request: service_pb2.GetCatalogRequest, context: grpc.ServicerContext
        ) -> service_pb2.GetCatalogResponse:
            offered = catalog(self.frame_rate)
            offered.limits.max_clip_frames = offered.limits.max_clip_samples = HORIZON
            return offered

        def GenerateClip(
            self, request: service_pb2.GenerateClipRequest, context: grpc.ServicerContext
        ) -> Iterator[service_pb2.GenerateClipResponse]:
            self.clips = 1
            gone = threading.Event()
            if context.add_callback(gone.set):
                gone.wait(LIMIT_S)
            return iter(())

        clips = 0

    with Busy() as running:
        yield running


async def test_closing_the_client_ends_a_clip_with_stream_lost_not_cancellation(busy: FakeServer) -> None:
    client = await MotionClient(busy.address).connect()
    clip = asyncio.create_task(client.generate_clip("walk", num_frames=8))
    await until(lambda: busy.clips)  # type: ignore[attr-defined]
    await client.close()
    with pytest.raises(StreamLost, match=r"the client was closed"):
        await clip


async def test_callback_that_raises_is_logged_and_the_session_continues(
    client: MotionClient, server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    session = await client.open("walk")

    def fail(_: object) -> None:
        raise RuntimeError("a mistake of the application")

    session.on_service_level = session.on_constraint_reached = session.on_durability = fail
    with caplog.at_level(logging.ERROR, "motiongen_client"):
        level = session_pb2.ServiceLevel(tier=session_pb2.SERVICE_TIER_HOLD, denoise_steps=1)
        server.stream.push(session.handle, service_level=level)
        server.stream.push(session.handle, constraint_reached=session_pb2.ConstraintReached(constraint_id=1))
        server.stream.push(session.handle, durability=session_pb2.SessionDurability(is_kept=True))
        await session.set_prompt("answered behind all three")
    assert caplog.text.count("RuntimeError: a mistake of the application") == 3
    assert session.service_level.tier == "hold"
    assert session.is_durable
    assert len(server.streams) == 1


async def test_failing_token_function_is_called_again_on_reconnection(
    server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    asked = []

    def token() -> str:
        asked.append(len(asked))
        if len(asked) in (3, 4):  # after the connection was lost
            raise ConnectionError("the issuer does not answer")
        return "secret"

    async with MotionClient(server.address, token=token) as client:
        session = await client.open("walk")
        assert len(asked) == 2
        with caplog.at_level(logging.WARNING, "motiongen_client"):
            server.stream.fail(grpc.StatusCode.UNAVAILABLE)
            await until(lambda: len(server.streams) == 2 and not session.is_away)
        assert caplog.text.count("the issuer does not answer") == 2
        await session.set_prompt("run")
