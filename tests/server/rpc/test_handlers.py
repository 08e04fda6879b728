"""The methods that gRPC is given: all of the contract's, under their names."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import grpc

from motiongen_server.rpc.handlers import SERVICE, add_methods


class Server:
    """Keeps what is added to it."""

    def __init__(self) -> None:
        self.served: dict[str, grpc.RpcMethodHandler[Any, Any]] = {}

    def add_registered_method_handlers(
        self, service: str, handlers: dict[str, grpc.RpcMethodHandler[Any, Any]]
    ) -> None:
        self.served |= {f"{service}.{name}": handler for name, handler in handlers.items()}


def test_every_method_of_the_contract_is_served_and_none_has_its_request_awaited_by_grpc() -> None:
    """gRPC would wait for ever. On the wire a stream of one message is the same as a message."""
    server: Any = Server()
    methods: Any = SimpleNamespace(**{method.name: object() for method in SERVICE.methods})
    add_methods(methods, server)
    assert set(server.served) == {method.full_name for method in SERVICE.methods}
    for method in SERVICE.methods:
        assert server.served[method.full_name].stream_stream is not None
