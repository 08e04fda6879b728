"""StartingService: answers calls while the model loads, so that the port can be open from the start."""

from __future__ import annotations

from collections.abc import AsyncIterator

import grpc

from motiongen.v1 import service_pb2
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.calls.context import CallContext, refuse
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.service import MotionService

RETRY_AFTER_S = 1.0


class StartingService:
    """Refuses calls with UNAVAILABLE until it is opened, and then passes them on."""

    def __init__(self) -> None:
        self._service: MotionService | None = None

    def open(self, service: MotionService) -> None:
        """Pass calls on to the service from now on."""
        self._service = service

    def shut(self) -> None:
        """Refuse calls again, as before `open`."""
        self._service = None

    @property
    def is_open(self) -> bool:
        """Whether calls are passed on."""
        return self._service is not None

    async def GetCatalog(self, call: CallContext) -> service_pb2.GetCatalogResponse:
        """As the service's."""
        return await self._opened().GetCatalog(call)

    async def StreamMotion(self, request_iterator: AsyncIterator[bytes], context: StreamContext) -> None:
        """As the service's."""
        try:
            service = self._opened()
        except StreamRefused as refusal:
            await refuse(context, refusal)
        await service.StreamMotion(request_iterator, context)

    async def GenerateClip(self, call: CallContext) -> None:
        """As the service's."""
        await self._opened().GenerateClip(call)

    def _opened(self) -> MotionService:
        """The service. Raises StreamRefused while there is none."""
        if self._service is None:
            raise StreamRefused(
                grpc.StatusCode.UNAVAILABLE,
                "STARTING",
                "the server is loading its model; try again when its health is SERVING",
                retry_after_s=RETRY_AFTER_S,
            )
        return self._service
