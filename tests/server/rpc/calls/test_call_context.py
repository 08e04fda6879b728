"""Calls that end early: refused ones whose client does not take the status, and those whose client leaves."""

from __future__ import annotations

import asyncio
from typing import Any

import grpc.aio
import pytest

from motiongen.v1 import service_pb2
from motiongen_server.rpc.calls.context import CallContext, streaming_method, unary_method
from motiongen_server.rpc.calls.requests import Requests, parsed_as
from tests.waiting import LIMIT_S


class Asked(bytes):
    """A request that notes when it is freed."""

    let_go: list[int]

    def __del__(self) -> None:
        self.let_go.append(len(self))


class Stuck:
    """The context of a call whose client sends this, and does not take the status for a while."""

    def __init__(self, *sends: Any) -> None:
        self._sends = list(sends)
        self.is_ending = asyncio.Event()
        self.takes = asyncio.Event()
        self.code: grpc.StatusCode | None = None

    def peer(self) -> str:
        return "ipv4:10.0.0.7:1"

    async def read(self) -> Any:
        return self._sends.pop(0)

    async def abort(self, code: grpc.StatusCode, *_: object) -> None:
        self.code = code
        self.is_ending.set()
        await self.takes.wait()


async def parse_garbage(call: CallContext) -> service_pb2.GetCatalogResponse:
    parsed_as(service_pb2.GetCatalogRequest, await call.request())
    raise AssertionError("garbage was accepted")


async def test_refused_request_is_freed_before_the_client_takes_the_status() -> None:
    for data in (b"\xff", b"a" * 5000):
        asked = Asked(data)
        let_go = asked.let_go = []
        stuck = Stuck(asked, grpc.aio.EOF)
        del asked
        handler = unary_method(parse_garbage, Requests()).stream_stream
        serving = asyncio.create_task(handler(None, stuck))
        async with asyncio.timeout(LIMIT_S):
            await stuck.is_ending.wait()
            assert let_go == [len(data)]
            stuck.takes.set()
            await serving
        assert stuck.code is grpc.StatusCode.INVALID_ARGUMENT


async def test_client_that_leaves_during_a_write_is_not_logged_as_a_fault() -> None:
    class Gone(Stuck):
        async def write(self, _: object) -> None:
            raise grpc.aio.InternalError("the client has gone")

    async def told(call: CallContext) -> None:
        await call.write(service_pb2.GetCatalogResponse())

    handler = streaming_method(told, Requests()).stream_stream
    with pytest.raises(asyncio.CancelledError):  # which gRPC does not log
        await handler(None, Gone())
