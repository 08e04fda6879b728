"""A call for clips whose time ends while a response is being written."""

from __future__ import annotations

import asyncio

import grpc

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.limits import Limits, PeerLimits
from tests.contract.local import LocalServer
from tests.waiting import LIMIT_S

ASKED = service_pb2.GenerateClipRequest(open=session_pb2.OpenSession(), frame_count=40)


MOST_S = 0.2


class SlowConnection:
    """The context of a call whose first response is being written until after the call's time has ended."""

    def __init__(self) -> None:
        self.sent = asyncio.Event()
        self.is_writing = False
        self.told: list[tuple[grpc.StatusCode, bool]] = []

    def time_remaining(self) -> None:
        return None

    async def write(self, response: service_pb2.GenerateClipResponse) -> None:
        self.is_writing = True
        # Counted from after the call's time has begun, however late that is.
        asyncio.get_running_loop().call_later(2 * MOST_S, self.sent.set)
        await self.sent.wait()
        self.is_writing = False

    async def abort_with_status(self, status: grpc.Status) -> None:
        self.told.append((status.code, self.is_writing))


async def test_status_of_a_call_that_ran_out_of_time_follows_the_pending_response() -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer(Limits(max_clip_s=MOST_S)) as server:
        connection = SlowConnection()
        await server.service.clips.generate(ASKED, connection, Peer(PeerLimits(), 0.0))  # type: ignore[arg-type]
        assert connection.told == [(grpc.StatusCode.DEADLINE_EXCEEDED, False)]
