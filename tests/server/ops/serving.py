"""The port of operations of a test, served by this event loop."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from prometheus_client import CollectorRegistry

from motiongen_server.ops.http import OpsServer, ops_app
from tests.waiting import LIMIT_S


@asynccontextmanager
async def serving(is_alive: Callable[[], bool] = lambda: True) -> AsyncIterator[int]:
    """A free port of this machine, with checks and metrics of an empty registry. is_alive: what `/livez` asks."""
    server = OpsServer(ops_app(CollectorRegistry(), is_alive, lambda: True), "127.0.0.1", 0)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        serving = asyncio.create_task(server.serve([listener]))
        try:
            async with asyncio.timeout(LIMIT_S):
                yield listener.getsockname()[1]
        finally:
            server.should_exit = True
            await serving
