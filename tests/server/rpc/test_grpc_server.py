"""Servers of gRPC: what no client may do to one, whatever it asks for."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import pytest

from motiongen_server.rpc.grpc_server import make_server, serve_methods
from tests.raw_calls import Header, answer_to, status_in
from tests.waiting import LIMIT_S

SERVED = b"/motiongen.test.Echo/Say"
OK, UNIMPLEMENTED = 0, 12


@asynccontextmanager
async def served() -> AsyncIterator[int]:
    """The port of a server with one method, which answers with each message that comes."""

    async def say(_messages: object, context: Any) -> None:
        while isinstance(message := await context.read(), bytes):
            await context.write(message)
        context.set_details("over")

    async with asyncio.timeout(LIMIT_S):
        server = make_server()
        serve_methods(server, "motiongen.test.Echo", {"Say": grpc.stream_stream_rpc_method_handler(say)})
        port = server.add_insecure_port("127.0.0.1:0")
        await server.start()
        yield port
        await server.stop(None)


@pytest.mark.parametrize("path", [b"/motiongen.test.Echo/\xff", b"\xff\xfe", b"/nobody.Serves/This"])
async def test_a_method_that_nobody_serves_is_refused_whatever_its_name_and_streams_go_on(
    path: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async with served() as port, grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        stream = channel.stream_stream(SERVED.decode())()
        await stream.write(b"before")
        assert await stream.read() == b"before"
        for _ in range(3):
            assert status_in(await asyncio.to_thread(answer_to, port, path)) == UNIMPLEMENTED
        await stream.write(b"after")
        assert await stream.read() == b"after"
        await stream.done_writing()
        assert await stream.code() is grpc.StatusCode.OK
    assert not caplog.records


@pytest.mark.parametrize(
    "header", [(b"authorization", b"Bearer mg_secret\xff"), (b"user-agent", b"\xff"), (b"\xff", b"x")]
)
async def test_metadata_that_is_no_text_is_not_logged(header: Header, caplog: pytest.LogCaptureFixture) -> None:
    async with served() as port:
        await asyncio.to_thread(answer_to, port, SERVED, header)
        assert status_in(await asyncio.to_thread(answer_to, port, SERVED)) == OK
    assert not caplog.records
