"""The methods of MotionService, as gRPC is given them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any, Protocol, TypeAlias

import grpc
import grpc.aio

from motiongen.v1 import service_pb2

SERVICE = service_pb2.DESCRIPTOR.services_by_name["MotionService"]
SERVICE_NAME = SERVICE.full_name

CatalogContext: TypeAlias = "grpc.aio.ServicerContext[service_pb2.GetCatalogRequest, service_pb2.GetCatalogResponse]"
ClipContext: TypeAlias = "grpc.aio.ServicerContext[bytes, service_pb2.GenerateClipResponse]"
StreamContext: TypeAlias = "grpc.aio.ServicerContext[bytes, bytes]"
AnyContext: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"


class Handlers(Protocol):
    """What answers the calls. A stream's messages are bytes both ways, and so is the request of a clip.

    See `rpc.convert.wire`, and `rpc.request_parts`: what comes is charged before it is parsed.
    """

    async def GetCatalog(
        self, request: service_pb2.GetCatalogRequest, context: CatalogContext
    ) -> service_pb2.GetCatalogResponse: ...

    async def StreamMotion(self, request_iterator: AsyncIterator[bytes], context: StreamContext) -> None: ...

    async def GenerateClip(self, request: bytes, context: ClipContext) -> None: ...


def add_methods(methods: Handlers, server: grpc.aio.Server) -> None:
    """Serve the methods. As the generated `add_MotionServiceServicer_to_server`, but for what is bytes here."""
    handlers: dict[str, grpc.RpcMethodHandler[Any, Any]] = {
        "GetCatalog": grpc.unary_unary_rpc_method_handler(
            methods.GetCatalog,
            request_deserializer=service_pb2.GetCatalogRequest.FromString,
            response_serializer=service_pb2.GetCatalogResponse.SerializeToString,
        ),
        "GenerateClip": grpc.unary_stream_rpc_method_handler(
            methods.GenerateClip,
            response_serializer=service_pb2.GenerateClipResponse.SerializeToString,
        ),
        "StreamMotion": grpc.stream_stream_rpc_method_handler(methods.StreamMotion),
    }
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE_NAME, handlers),))
