"""A flooding client that reads nothing, seen from inside the server."""

from __future__ import annotations

import asyncio

from motiongen.v1 import service_pb2, session_pb2
from motiongen_compliance.target import Target
from motiongen_server.rpc.request_parts import TAKEN_APART
from tests.contract.local import LocalServer


async def test_unread_answers_to_a_flood_stay_within_the_limit(local_server: LocalServer, local: Target) -> None:
    other, flooder = await local.talk(), await local.talk()
    await other.open(1)
    limits = local_server.limits
    nothing = session_pb2.SessionEvent(session=5)  # four bytes, answered with a few hundred
    request = service_pb2.StreamMotionRequest(events=[nothing] * 100_000)

    async def flood() -> None:
        while True:
            await flooder.call.write(request)

    flooding = asyncio.create_task(flood())
    while local_server.service.num_waiting_bytes <= limits.hard_backlog_bytes:
        await other.ping(1)  # gives the event loop a turn, without an event that counts towards a rate limit
    for _ in range(5):
        await other.plays_on(1)
        most_bytes = (
            1.1 * limits.hard_backlog_bytes + TAKEN_APART * request.ByteSize()
        )  # the request that is waiting to be paid for
        assert local_server.service.num_waiting_bytes < most_bytes
    flooding.cancel()
    flooder.call.cancel()
    while local_server.service.num_streams > 1:
        await other.ping(1)
