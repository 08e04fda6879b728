"""One call after another: what a call is told at its beginning, when it is given up, and when the next is made."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import grpc
import pytest

from motiongen.v1 import service_pb2
from motiongen_client import LinePolicy, MotionClient, Stream
from motiongen_client.backoff import LONGEST_DELAY_S, Backoff
from motiongen_client.call import Call
from motiongen_client.calls import LAG_S, Calls
from motiongen_client.errors import MotiongenError
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer
from tests.client.waiting import until
from tests.waiting import until as wait_for

PONG_S = 5.0
POLICY = LinePolicy(ping_s=PONG_S, pong_timeout_s=PONG_S)


async def turns() -> None:
    for _ in range(20):  # of the event loop: until all that is due has run
        await asyncio.sleep(0)


def own_stream(client: MotionClient) -> Stream:
    assert client._own_stream is not None
    return client._own_stream


@pytest.fixture
def asked_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The least delays with which the next calls were to be made."""
    asked: list[float] = []
    draw = Backoff.next_s

    def next_s(backoff: Backoff, at_least_s: float = 0.0) -> float:
        asked.append(at_least_s)
        return draw(backoff, at_least_s)

    monkeypatch.setattr(Backoff, "next_s", next_s)
    return asked


async def test_round_trip_is_reported_as_soon_as_it_is_measured(clock: ManualClock, server: FakeServer) -> None:
    async with MotionClient(server.address, policy=POLICY) as client:
        session = await client.open("walk")
        await until(lambda: own_stream(client).round_trip_s is not None)
        await session.set_prompt("run")  # goes with the next message or later, and so not before the ping
        assert [ping.HasField("round_trip") for ping in server.stream.pings] == [False, True]


async def test_pong_that_was_late_because_this_process_was_stalled_keeps_the_call(
    clock: ManualClock, server: FakeServer
) -> None:
    async with MotionClient(server.address, policy=POLICY) as client:
        await client.open("walk")
        stream = own_stream(client)
        await until(lambda: stream._calls._ponged.is_set() and not stream._calls._pinged_ns)
        clock.advance(PONG_S)
        server.stream.answers_pings = False
        await until(lambda: len(server.stream.pings) > 2)
        clock.advance(PONG_S)
        await turns()
        assert stream.is_connected, "what has arrived meanwhile is still to be read"
        pong = service_pb2.Pong(client_time_ns=server.stream.pings[-1].client_time_ns)
        server.stream.outgoing.put(service_pb2.StreamMotionResponse(pong=pong))
        await until(stream._calls._ponged.is_set)
        clock.advance(LAG_S)
        await turns()
        assert stream.is_connected
        clock.advance(PONG_S)  # for the next ping, which gets no pong
        await turns()
        clock.advance(LAG_S)
        await turns()
        assert not stream.is_connected


async def test_call_lost_while_the_catalogue_is_fetched_is_followed_by_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lost: list[MotiongenError] = []
    lose = Calls._lose

    def note(calls: Calls, call: Call, failure: MotiongenError) -> None:
        lost.append(failure)
        lose(calls, call, failure)

    class Dropping(FakeServer):
        """Ends its second stream, and answers the request for the catalogue once the client knows."""

        def GetCatalog(
            self, request: service_pb2.GetCatalogRequest, context: grpc.ServicerContext
        ) -> service_pb2.GetCatalogResponse:
            if len(self.streams) == 2:
                self.stream.fail(grpc.StatusCode.UNAVAILABLE)
                wait_for(lambda: len(lost) == 2)
            return super().GetCatalog(request, context)

    monkeypatch.setattr(Calls, "_lose", note)
    with Dropping() as server:
        async with MotionClient(server.address) as client:
            session = await client.open("walk")
            server.stream.fail(grpc.StatusCode.UNAVAILABLE)
            await until(lambda: session.reopenings)
            assert len(server.streams) == 3


async def test_wait_asked_for_in_a_goodbye_is_over_with_the_next_call(
    clock: ManualClock, server: FakeServer, asked_s: list[float]
) -> None:
    async with MotionClient(server.address, policy=replace(POLICY, ping_s=1e6, pong_timeout_s=1e6)) as client:
        session = await client.open("walk")
        goodbye = service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING)
        goodbye.reconnect_after.FromSeconds(60)
        server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=goodbye))
        server.stream.end()
        await until(lambda: asked_s)
        clock.advance(60)
        await until(lambda: session.reopenings)
        server.stream.end()
        await until(lambda: len(asked_s) == 2)
        assert asked_s == [60.0, 0.0]


async def test_no_call_is_made_for_a_stream_without_sessions_until_one_is_needed(
    clock: ManualClock, server: FakeServer, asked_s: list[float]
) -> None:
    async with MotionClient(server.address, policy=replace(POLICY, ping_s=1e6, pong_timeout_s=1e6)) as client:
        session = await client.open("walk")
        server.stream.end()
        await until(lambda: asked_s)
        clock.advance(LONGEST_DELAY_S)
        await until(lambda: session.reopenings)
        await session.close()
        server.stream.end()
        await until(lambda: not own_stream(client).is_connected)
        await turns()
        assert len(asked_s) == 1
        opening = asyncio.create_task(client.open("run"))
        await until(lambda: len(asked_s) == 2)
        clock.advance(LONGEST_DELAY_S)
        await opening
