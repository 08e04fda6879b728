"""The methods that gRPC is given: all of the contract's, under their names."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import grpc

from motiongen_server.rpc.handlers import SERVICE, add_methods


class Server:
    """Keeps what is added to it."""

    def __init__(self) -> None:
        self.handlers: list[grpc.GenericRpcHandler] = []

    def add_generic_rpc_handlers(self, handlers: tuple[grpc.GenericRpcHandler, ...]) -> None:
        self.handlers += handlers


def test_every_method_of_the_contract_is_served_and_none_has_its_request_awaited_by_grpc() -> None:
    """gRPC would wait for ever. On the wire a stream of one message is the same as a message."""
    server: Any = Server()
    methods: Any = SimpleNamespace(**{method.name: object() for method in SERVICE.methods})
    add_methods(methods, server)
    (handler,) = server.handlers
    for method in SERVICE.methods:
        served = handler.service(SimpleNamespace(method=f"/{SERVICE.full_name}/{method.name}"))
        assert served is not None, method.name
        assert served.stream_stream is not None
