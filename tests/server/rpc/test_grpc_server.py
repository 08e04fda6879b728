"""What no client can do to a gRPC server, whatever it sends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import pytest
from grpc._cython import cygrpc  # type: ignore[attr-defined]  # which has no stubs

from motiongen_server.rpc.calls.headers import HeaderTime
from tests.raw_calls import Header, answer_to, beginning, call_of, frame, status_in
from tests.server.rpc.one_method import SERVED, serving

OK, INVALID, UNIMPLEMENTED, INTERNAL = 0, 3, 12, 13
RST_STREAM, CANCEL = 3, b"\0\0\0\x08"


@asynccontextmanager
async def served() -> AsyncIterator[int]:
    """Yields the port of a server whose only method echoes every message."""

    async def say(_messages: object, context: Any) -> None:
        while isinstance(message := await context.read(), bytes):
            await context.write(message)
        context.set_details("over")

    async with serving(say) as port:
        yield port


@pytest.mark.parametrize("path", [b"/motiongen.test.Echo/\xff", b"\xff\xfe", b"/nobody.Serves/This"])
async def test_call_to_an_unknown_method_is_refused_and_open_streams_continue(
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
async def test_metadata_that_is_not_valid_text_is_not_logged(header: Header, caplog: pytest.LogCaptureFixture) -> None:
    async with served() as port:
        await asyncio.to_thread(answer_to, port, SERVED, header)
        assert status_in(await asyncio.to_thread(answer_to, port, SERVED)) == OK
    assert not caplog.records


@pytest.mark.parametrize("path", [SERVED, b"/nobody.Serves/This"])
async def test_call_that_is_reset_at_once_is_not_logged(path: bytes, caplog: pytest.LogCaptureFixture) -> None:
    async with served() as port:
        begun_and_reset = (call_of(stream, path) + frame(RST_STREAM, 0, stream, CANCEL) for stream in range(1, 41, 2))
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(beginning() + b"".join(begun_and_reset))
        assert status_in(await asyncio.to_thread(answer_to, port, path)) == (OK if path == SERVED else UNIMPLEMENTED)
        writer.transport.abort()
    assert not caplog.records


@pytest.mark.parametrize(
    ("path", "num_headers", "status", "is_read"),
    [(SERVED, 1, OK, True), (SERVED, 1000, INVALID, False), (b"/nobody.Serves/This", 1000, UNIMPLEMENTED, False)],
)
async def test_grpc_reads_no_headers_of_calls_that_are_refused(
    path: bytes, num_headers: int, status: int, is_read: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """gRPC reads all headers of a call that it serves: a hundred thousand of them take the event loop 50 ms."""
    served_by_grpc: list[str] = []
    serve = cygrpc._handle_rpc

    def note(name: str, *more: Any) -> Any:
        served_by_grpc.append(name)
        return serve(name, *more)

    monkeypatch.setattr(cygrpc, "_handle_rpc", note)
    async with served() as port:
        answer = await asyncio.to_thread(answer_to, port, path, *[(b"k", b"v")] * num_headers)
        assert status_in(answer) == status
    assert served_by_grpc == [SERVED.decode()] * is_read


async def test_fault_before_a_call_begins_fails_the_call_and_not_the_server(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_self: HeaderTime, _context: Any) -> None:
        raise RuntimeError("a fault")

    monkeypatch.setattr(HeaderTime, "check", fail)
    async with served() as port:
        assert status_in(await asyncio.to_thread(answer_to, port, SERVED)) == INTERNAL
        assert status_in(await asyncio.to_thread(answer_to, port, b"/nobody.Serves/This")) == UNIMPLEMENTED
    (record,) = caplog.records
    assert record.exc_info is not None
