"""GoodStream: a call of a good client, on which several tasks read and write."""

from __future__ import annotations

import asyncio

from motiongen.v1 import service_pb2, service_pb2_grpc
from tests.attack.tokens import Metadata


class GoodStream:
    """A base class. Tasks that subclasses start belong in `_tasks`. metadata: of the call."""

    def __init__(self, stub: service_pb2_grpc.MotionServiceStub, metadata: Metadata = ()) -> None:
        self._call = stub.StreamMotion(metadata=metadata)
        self._tasks: list[asyncio.Task[None]] = []
        self._writing = asyncio.Lock()  # a call takes one message at a time

    async def _write(self, request: service_pb2.StreamMotionRequest) -> None:
        async with self._writing:
            await self._call.write(request)

    async def end(self) -> None:
        self._call.cancel()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
