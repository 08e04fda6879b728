"""Newcomers: sessions that good clients open during an attack, one after another, and what happens to them."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import grpc.aio

from motiongen.v1 import service_pb2, service_pb2_grpc, session_pb2
from tests.attack.good_stream import GoodStream
from tests.attack.tokens import Metadata

OPEN_EVERY_S = 0.5


class Newcomers(GoodStream):
    """A stream on which sessions are opened and, once they have frames, closed.

    num_served: how many got frames. refused: how many were refused, by reason; refused_ms: how soon. num_waiting: how
    many were still waiting at the end.
    """

    def __init__(self, stub: service_pb2_grpc.MotionServiceStub, metadata: Metadata = ()) -> None:
        super().__init__(stub, metadata)
        self._asked: dict[int, float] = {}
        self._handle = 0
        self.num_served = 0
        self.refused: Counter[str] = Counter()
        self.refused_ms: list[float] = []
        self.num_waiting = 0

    async def begin(self) -> None:
        """Begin the stream, and open one session after another."""
        hello = service_pb2.ClientHello(client_agent="newcomer")
        await self._write(service_pb2.StreamMotionRequest(hello=hello))
        self._opening = asyncio.create_task(self._open())
        self._tasks = [asyncio.create_task(self._read()), self._opening]

    def forget(self) -> None:
        """Discard what was counted before the attack."""
        self._asked.clear()
        self.num_served = 0
        self.refused.clear()
        self.refused_ms.clear()

    def stop(self, patience_s: float) -> None:
        """Open no more. patience_s: how long to wait for those that have no frames yet."""
        self._opening.cancel()
        now = time.perf_counter()
        self.num_waiting = sum(now - asked_s > patience_s for asked_s in self._asked.values())

    async def _open(self) -> None:
        while True:
            self._handle += 1
            opening = session_pb2.OpenSession(priority=session_pb2.PRIORITY_CLASS_CROWD)
            event = session_pb2.SessionEvent(session=self._handle, event_seq=1, open=opening)
            self._asked[self._handle] = time.perf_counter()
            await self._write(service_pb2.StreamMotionRequest(events=[event]))
            await asyncio.sleep(OPEN_EVERY_S)

    async def _read(self) -> None:
        while isinstance(response := await self._call.read(), service_pb2.StreamMotionResponse):
            for update in response.updates:
                kind = update.WhichOneof("update")
                if kind == "outcome" and update.outcome.code and update.session in self._asked:
                    self.refused_ms.append(1000 * (time.perf_counter() - self._asked.pop(update.session)))
                    self.refused[update.outcome.reason] += 1
                elif kind == "chunk" and self._asked.pop(update.session, None) is not None:
                    self.num_served += 1
                    close = session_pb2.SessionEvent(
                        session=update.session, event_seq=2, close=session_pb2.CloseSession()
                    )
                    await self._write(service_pb2.StreamMotionRequest(events=[close]))


@asynccontextmanager
async def newcomers(address: str, metadata: Metadata = ()) -> AsyncIterator[Newcomers]:
    """Newcomers on a new connection. metadata: of their call."""
    async with grpc.aio.insecure_channel(address, options=(("grpc.use_local_subchannel_pool", 1),)) as channel:
        coming = Newcomers(service_pb2_grpc.MotionServiceStub(channel), metadata)
        try:
            await coming.begin()
            yield coming
        finally:
            await coming.end()
