"""A call for clips whose time is over while a response is being written."""

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


class SlowLine:
    """A call's context whose first response is on its way until the call's time is over."""

    def __init__(self) -> None:
        self.sent = asyncio.Event()
        self.is_writing = False
        self.told: list[tuple[grpc.StatusCode, bool]] = []

    def time_remaining(self) -> None:
        return None

    async def write(self, response: service_pb2.GenerateClipResponse) -> None:
        self.is_writing = True
        # Begins after the call's time has begun, however late that is.
        asyncio.get_running_loop().call_later(2 * MOST_S, self.sent.set)
        await self.sent.wait()
        self.is_writing = False

    async def abort_with_status(self, status: grpc.Status) -> None:
        self.told.append((status.code, self.is_writing))


async def test_a_call_whose_time_ends_while_a_response_is_written_has_its_status_after_it() -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer(Limits(max_clip_s=MOST_S)) as server:
        line = SlowLine()
        await server.service.clips.generate(ASKED, line, Peer(PeerLimits(), 0.0))  # type: ignore[arg-type]
        assert line.told == [(grpc.StatusCode.DEADLINE_EXCEEDED, False)]
