"""A call that is refused: nothing of what was asked is kept while its client does not take the status."""

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
    """Tells when nobody has it any more."""

    let_go: list[int]

    def __del__(self) -> None:
        self.let_go.append(len(self))


class Stuck:
    """The context of a call whose client sends this, and takes no status for a while."""

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


async def garbage_asked(call: CallContext) -> service_pb2.GetCatalogResponse:
    parsed_as(service_pb2.GetCatalogRequest, await call.request())
    raise AssertionError("garbage was taken")


async def test_a_request_that_is_refused_is_let_go_before_the_status_is_taken() -> None:
    for data in (b"\xff", b"a" * 5000):
        asked = Asked(data)
        let_go = asked.let_go = []
        stuck = Stuck(asked, grpc.aio.EOF)
        del asked
        handler = unary_method(garbage_asked, Requests()).stream_stream
        serving = asyncio.create_task(handler(None, stuck))
        async with asyncio.timeout(LIMIT_S):
            await stuck.is_ending.wait()
            assert let_go == [len(data)]
            stuck.takes.set()
            await serving
        assert stuck.code is grpc.StatusCode.INVALID_ARGUMENT


async def test_a_client_that_goes_while_it_is_written_to_is_no_fault() -> None:
    class Gone(Stuck):
        async def write(self, _: object) -> None:
            raise grpc.aio.InternalError("nobody is there")

    async def told(call: CallContext) -> None:
        await call.write(service_pb2.GetCatalogResponse())

    handler = streaming_method(told, Requests()).stream_stream
    with pytest.raises(asyncio.CancelledError):  # which gRPC does not log
        await handler(None, Gone())
