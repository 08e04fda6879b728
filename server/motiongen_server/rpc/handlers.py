"""Registers the methods of MotionService with gRPC."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any, Protocol, TypeAlias

import grpc
import grpc.aio

from motiongen.v1 import service_pb2
from motiongen_server.rpc.calls.context import CallContext, streaming_method, unary_method
from motiongen_server.rpc.calls.requests import Requests
from motiongen_server.rpc.grpc_server import serve_methods

SERVICE = service_pb2.DESCRIPTOR.services_by_name["MotionService"]
SERVICE_NAME = SERVICE.full_name

StreamContext: TypeAlias = "grpc.aio.ServicerContext[bytes, bytes]"
AnyContext: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"


class Handlers(Protocol):
    """Answers the calls. A stream's messages are bytes in both directions, and so are the requests of other methods.

    See `rpc.convert.wire`, and `rpc.request_parts`: messages are charged before they are parsed. A call with one
    request is charged before the request has come.
    """

    async def GetCatalog(self, call: CallContext) -> service_pb2.GetCatalogResponse: ...

    async def StreamMotion(self, request_iterator: AsyncIterator[bytes], context: StreamContext) -> None: ...

    async def GenerateClip(self, call: CallContext) -> None: ...


def add_methods(methods: Handlers, server: grpc.aio.Server, requests: Requests | None = None) -> None:
    """Serve the methods, as the generated `add_MotionServiceServicer_to_server` does, but with bytes as above.

    requests: shared by all calls of that server.
    """
    requests = requests or Requests()
    handlers: dict[str, grpc.RpcMethodHandler[Any, Any]] = {
        "GetCatalog": unary_method(methods.GetCatalog, requests),
        "GenerateClip": streaming_method(methods.GenerateClip, requests),
        "StreamMotion": grpc.stream_stream_rpc_method_handler(methods.StreamMotion),
    }
    serve_methods(server, SERVICE_NAME, handlers)
