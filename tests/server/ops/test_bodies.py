"""Bodies of requests to the port of operations, which takes none: they are not looked at, in chunks of a byte least."""

from __future__ import annotations

import asyncio
import socket

import pytest
from prometheus_client import CollectorRegistry

from motiongen_server.ops import http
from tests.waiting import LIMIT_S

HEAD = b"GET /livez HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n"
NO_CHUNK = b"zz\r\n"


@pytest.mark.parametrize("parts", [(HEAD + NO_CHUNK,), (HEAD[:-2], HEAD[-2:] + NO_CHUNK), (HEAD, NO_CHUNK)])
async def test_a_body_is_not_looked_at(parts: tuple[bytes, ...]) -> None:
    server = http.OpsServer(http.ops_app(CollectorRegistry(), lambda: True, lambda: True), "127.0.0.1", 0)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        serving = asyncio.create_task(server.serve([listener]))
        try:
            async with asyncio.timeout(LIMIT_S):
                reader, writer = await asyncio.open_connection("127.0.0.1", listener.getsockname()[1])
                for part in parts:
                    writer.write(part)
                    await asyncio.sleep(0)
                assert (await reader.readline()).startswith(b"HTTP/1.1 200")
                writer.transport.abort()
        finally:
            server.should_exit = True
            await serving
