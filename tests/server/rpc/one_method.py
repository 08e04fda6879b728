"""A gRPC server with one method, for tests of what clients can do to any server."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio

from motiongen_server.rpc.calls.call_pace import CALLS_A_SECOND
from motiongen_server.rpc.grpc_server import make_server, serve_methods
from tests.waiting import LIMIT_S

SERVED = b"/motiongen.test.Echo/Say"


@asynccontextmanager
async def serving(
    say: Callable[[object, Any], Awaitable[None]], calls_a_second: float = CALLS_A_SECOND
) -> AsyncIterator[int]:
    """Serves the method `SERVED` and yields the port. say: the method's handler. calls_a_second: of an address."""
    async with asyncio.timeout(LIMIT_S):
        server = make_server(calls_a_second=calls_a_second)
        serve_methods(server, "motiongen.test.Echo", {"Say": grpc.stream_stream_rpc_method_handler(say)})
        port = server.add_insecure_port("127.0.0.1:0")
        await server.start()
        yield port
        await server.stop(None)
