"""The methods registered with gRPC: all of the contract's, under their names."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import grpc

from motiongen.v1 import service_pb2
from motiongen_server.rpc.calls.requests import Requests
from motiongen_server.rpc.handlers import SERVICE, add_methods


class Server:
    """Keeps the handlers that are registered with it."""

    def __init__(self) -> None:
        self.served: dict[str, grpc.RpcMethodHandler[Any, Any]] = {}

    def add_registered_method_handlers(
        self, service: str, handlers: dict[str, grpc.RpcMethodHandler[Any, Any]]
    ) -> None:
        self.served |= {f"{service}.{name}": handler for name, handler in handlers.items()}


def test_every_contract_method_is_registered_as_stream_stream() -> None:
    """Otherwise gRPC would wait for the request for ever. On the wire, a stream of one message equals one message."""
    server: Any = Server()
    methods: Any = SimpleNamespace(**{method.name: object() for method in SERVICE.methods})
    add_methods(methods, server)
    assert set(server.served) == {method.full_name for method in SERVICE.methods}
    for method in SERVICE.methods:
        assert server.served[method.full_name].stream_stream is not None


async def test_the_methods_with_one_request_await_it_together_with_the_server_s_others() -> None:
    """How long, and how many at once, is said for all calls of a server."""
    awaited: list[object] = []

    class Only(Requests):
        async def only(self, *_: object) -> bytes:
            awaited.append(self)
            return b""

    async def generate(call: Any) -> None:
        await call.request()

    async def catalog(call: Any) -> service_pb2.GetCatalogResponse:
        await call.request()
        return service_pb2.GetCatalogResponse()

    async def write(_: object) -> None:
        """Nobody reads it."""

    server: Any = Server()
    methods: Any = SimpleNamespace(GetCatalog=catalog, GenerateClip=generate, StreamMotion=None)
    requests = Only()
    add_methods(methods, server, requests)
    for name in ("GetCatalog", "GenerateClip"):
        await server.served[f"{SERVICE.full_name}.{name}"].stream_stream(None, SimpleNamespace(write=write))
    assert awaited == [requests] * 2
