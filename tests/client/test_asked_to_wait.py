"""A delay before reconnection that a server asks for is kept until `recover_s` ends, and for an hour at most."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import grpc
import pytest

from motiongen.v1 import service_pb2
from motiongen_client import LinePolicy, MotionClient, Session, StreamLost
from motiongen_client.backoff import LONGEST_ASKED_S, Backoff
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer
from tests.client.waiting import until

PATIENT = LinePolicy(recover_s=60.0, ping_s=1e6, pong_timeout_s=1e6)


class Loading(grpc.Status):
    """The status with which a server refuses streams until it has loaded its model."""

    code = grpc.StatusCode.UNAVAILABLE
    details = "it loads its model"
    trailing_metadata = ()


async def go_away(client: MotionClient, server: FakeServer, session: Session) -> None:
    """Have the server ask for no reconnection within an hour, and end the stream."""
    goodbye = service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING)
    goodbye.reconnect_after.FromSeconds(3600)
    server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=goodbye))
    server.stream.end()
    await until(lambda: session.is_away)
    for _ in range(10):  # until the task that makes the next call has begun to wait
        await asyncio.sleep(0)


async def test_last_attempt_is_made_when_recover_s_ends_however_long_the_server_asks(
    clock: ManualClock, server: FakeServer
) -> None:
    async with MotionClient(server.address, policy=PATIENT) as client:
        session = await client.open("walk")
        await go_away(client, server, session)
        clock.advance(59)
        for _ in range(10):
            await asyncio.sleep(0)
        assert len(server.streams) == 1, "it must not reconnect yet"
        clock.advance(1.5)
        await until(lambda: session.reopenings)
        assert len(server.streams) == 2


async def test_failed_last_attempt_is_reported_to_callers_when_recover_s_ends(
    clock: ManualClock, server: FakeServer
) -> None:
    async with MotionClient(server.address, policy=PATIENT) as client:
        session = await client.open("walk")
        server.turned_away = [Loading()] * 9
        await go_away(client, server, session)
        clock.advance(60.5)
        with pytest.raises(StreamLost, match="it loads its model"):
            await session.constraint_reached(1)


async def test_delay_that_a_server_asks_for_precedes_the_first_attempt_only(
    clock: ManualClock, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    draw = Backoff.next_s

    def next_s(backoff: Backoff, at_least_s: float = 0.0) -> float:
        asked.append(at_least_s)
        return draw(backoff, at_least_s)

    async with MotionClient(server.address, policy=replace(PATIENT, recover_s=None)) as client:
        session = await client.open("walk")
        server.turned_away = [Loading()]
        monkeypatch.setattr(Backoff, "next_s", next_s)
        await go_away(client, server, session)
        clock.advance(3600)
        await until(lambda: len(asked) == 2)
        assert asked == [3600.0, 0.0]


def test_delay_asked_for_by_a_server_is_capped_at_an_hour() -> None:
    assert Backoff().next_s(60.0) == 60.0
    assert Backoff().next_s(1e18) == LONGEST_ASKED_S == 3600.0
