"""The methods registered with gRPC: all of the contract's, under their names."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import grpc

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
