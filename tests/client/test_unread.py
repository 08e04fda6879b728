"""A call that ends while the client writes to it: updates sent before are read, and no task is left."""

from __future__ import annotations

import asyncio

import grpc

from motiongen.v1 import session_pb2
from motiongen_client import MotionClient
from tests.client.fake_server import FakeServer
from tests.client.waiting import until
from tests.waiting import until as wait_for

ROUNDS = 8


async def test_updates_sent_before_a_call_fails_are_all_read(server: FakeServer) -> None:
    """gRPC keeps a call with unread messages, and its connection; it reports a failed write before they are read."""
    told: list[bool] = []
    async with MotionClient(server.address) as client:
        session = await client.open("a person walks")
        session.on_durability = told.append
        for number in range(1, ROUNDS + 1):
            stream = server.stream
            for is_kept in (True, False) * 20:
                stream.push(session.handle, durability=session_pb2.SessionDurability(is_kept=is_kept))
            stream.fail(grpc.StatusCode.UNAVAILABLE)
            wait_for(lambda stream=stream: grpc.StatusCode.UNAVAILABLE not in stream.outgoing.queue)
            session.set_prompt("a person runs")
            await until(lambda number=number: len(session.reopenings) == number)  # type: ignore[misc]
            assert told == [True, False] * 20 * number
    async with asyncio.timeout(10):
        await until(lambda: asyncio.all_tasks() == {asyncio.current_task()})
