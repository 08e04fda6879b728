"""An operations port, served by the test's event loop."""

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
    """The number of a port with health checks and an empty metrics registry. is_alive: the answer of `/livez`."""
    server = OpsServer(ops_app(CollectorRegistry(), is_alive, lambda: True), "127.0.0.1", 0)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        serving = asyncio.create_task(server.serve([listener]))
        try:
            async with asyncio.timeout(LIMIT_S):
                yield listener.getsockname()[1]
        finally:
            server.should_exit = True
            await serving
