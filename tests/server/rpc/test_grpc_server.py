"""Servers of gRPC: what no client may do to one, whatever it asks for."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import pytest

from motiongen_server.rpc import grpc_server
from tests.raw_calls import Header, answer_to, status_in
from tests.server.rpc.one_method import SERVED, serving
from tests.waiting import LIMIT_S

OK, UNIMPLEMENTED = 0, 12


@asynccontextmanager
async def served() -> AsyncIterator[int]:
    """The port of a server with one method, which answers with each message that comes."""

    async def say(_messages: object, context: Any) -> None:
        while isinstance(message := await context.read(), bytes):
            await context.write(message)
        context.set_details("over")

    async with serving(say) as port:
        yield port


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


async def test_clients_that_have_gone_while_they_are_refused_are_not_logged_and_faults_are(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """gRPC's own words for what comes of a status that nobody takes."""
    log, said = logging.getLogger("grpc._cython.cygrpc"), "ExecuteBatchError raised in core by servicer method [%s]"
    async with served():
        for name in (grpc_server._NO_NAME, "/motiongen.test.Echo/Say"):
            log.error(said % name)
    assert [record.message for record in caplog.records] == [said % "/motiongen.test.Echo/Say"]


async def test_who_has_gone_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """gRPC never gives back the memory of a status that nobody takes."""
    refused: list[str] = []

    async def refuse() -> None:
        refused.append("told")

    monkeypatch.setattr(grpc_server, "SEEN_GONE_S", LIMIT_S)
    refusing = asyncio.create_task(grpc_server._once_seen(refuse()))
    await asyncio.sleep(0)
    refusing.cancel()  # as gRPC does then
    with pytest.raises(asyncio.CancelledError):
        await refusing
    assert not refused
    monkeypatch.setattr(grpc_server, "SEEN_GONE_S", 0.0)
    await grpc_server._once_seen(refuse())
    assert refused == ["told"]
