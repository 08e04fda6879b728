"""Bodies of requests to the operations port, which takes none: they are ignored, also malformed chunked ones."""

from __future__ import annotations

import asyncio

import pytest

from tests.server.ops.serving import serving

HEAD = b"GET /livez HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n"
MALFORMED_CHUNK = b"zz\r\n"


@pytest.mark.parametrize(
    "parts", [(HEAD + MALFORMED_CHUNK,), (HEAD[:-2], HEAD[-2:] + MALFORMED_CHUNK), (HEAD, MALFORMED_CHUNK)]
)
async def test_request_body_is_ignored(parts: tuple[bytes, ...]) -> None:
    async with serving() as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for part in parts:
            writer.write(part)
            await asyncio.sleep(0)
        assert (await reader.readline()).startswith(b"HTTP/1.1 200")
        writer.transport.abort()
