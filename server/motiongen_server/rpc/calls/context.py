"""CallContext: a gRPC call whose request must come within a time limit, and that counts until it is really over."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any, NoReturn

import grpc
import grpc.aio
from google.protobuf.message import Message

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.calls.requests import SMALL_REQUEST_BYTES, Arrive, Context, Requests, look_at
from motiongen_server.rpc.errors.streams import CLIENT_GONE

SEEN_GONE_S = 0.005
"""How long gRPC takes to report, by cancellation, that a client was gone before its call was served. gRPC never frees
the memory of a status that it cannot deliver (grpc/grpc#43360, ADR 87)."""


class CallContext:
    """Wraps the context that gRPC gives a method: reads and writes go on if their waits are cancelled.

    By HTTP/2's flow control, a client can keep a write from ever completing. gRPC then takes no status either, and the
    call occupies the server until its connection ends. So a write is never abandoned here, and `end`, which gives the
    call's places back, is not reached before the write is done.
    """

    def __init__(self, context: Context, requests: Requests) -> None:
        self._context = context
        self._requests = requests
        self._writing: asyncio.Future[None] | None = None
        self._reading: asyncio.Future[Any] | None = None
        self._held = contextlib.ExitStack()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def hold(self, give_back: Callable[[], None]) -> None:
        """Call give_back once the call is over."""
        self._held.callback(give_back)

    def end(self) -> None:
        """gRPC is done with the call."""
        self._held.close()

    async def request(self, most_bytes: int | None = SMALL_REQUEST_BYTES, arrive: Arrive | None = None) -> bytes:
        """The call's only request, see `Requests.only`. Raises StreamRefused if it does not come or is too long."""
        return await self._requests.only(self._context, most_bytes, arrive)

    async def read(self) -> Any:
        """Read the next request of several. The read goes on if this is cancelled."""
        self._reading = asyncio.ensure_future(self._context.read())
        self._reading.add_done_callback(look_at)
        return await asyncio.shield(self._reading)

    async def write(self, message: Message) -> None:
        """Write a response. The write goes on if this is cancelled."""
        self._writing = asyncio.ensure_future(self._context.write(message))
        self._writing.add_done_callback(look_at)
        await asyncio.shield(self._writing)

    async def abort_with_status(self, status: grpc.Status) -> NoReturn:
        """End the call once the current write is done."""
        await self.abort(status.code, status.details or "", status.trailing_metadata or ())

    async def abort(self, code: grpc.StatusCode, details: str = "", trailing_metadata: Any = ()) -> NoReturn:
        """End the call once the current write is done."""
        if self._writing is not None:
            await asyncio.wait({self._writing})
        await end_with(self._context, code, details, trailing_metadata)


async def end_with(context: Context, code: grpc.StatusCode, details: str, trailing_metadata: Any = ()) -> NoReturn:
    """End a call with a status. If its client has gone, this counts as a cancellation, and nothing is logged."""
    await asyncio.sleep(SEEN_GONE_S)
    try:
        await context.abort(code, details, trailing_metadata)
    except grpc.aio.AbortError as error:
        # gRPC keeps it with the call: its traceback would keep the call, and all headers, until garbage is collected.
        asyncio.get_running_loop().call_soon(error.with_traceback, None)
        raise
    except CLIENT_GONE as error:
        raise asyncio.CancelledError from error


async def refuse(context: Context, refusal: StreamRefused) -> NoReturn:
    """End a call with a refusal; see `end_with`."""
    status = refusal.status()
    await end_with(context, status.code, status.details or "", status.trailing_metadata or ())


def unary_method(
    answer: Callable[[CallContext], Awaitable[Message]], requests: Requests
) -> grpc.RpcMethodHandler[Any, Any]:
    """A method with one request and one response. answer may raise StreamRefused."""

    async def respond(call: CallContext) -> None:
        response = await answer(call)
        try:
            await call.write(response)
        except CLIENT_GONE as error:
            raise asyncio.CancelledError from error

    return streaming_method(respond, requests)


def streaming_method(
    respond: Callable[[CallContext], Awaitable[None]], requests: Requests
) -> grpc.RpcMethodHandler[Any, Any]:
    """A method that writes its own responses. respond may raise StreamRefused."""

    async def serve(_messages: object, context: Context) -> None:
        call = CallContext(context, requests)
        status: grpc.Status | None = None
        try:
            try:
                await respond(call)
            except StreamRefused as refusal:
                # Without its traceback, which would keep the request in memory until the status is taken.
                status = refusal.with_traceback(None).status()
            except grpc.aio.InternalError as error:  # a write whose client went away meanwhile: not our fault
                raise asyncio.CancelledError from error
            if status is not None:
                await call.abort_with_status(status)
        finally:
            call.end()

    return grpc.stream_stream_rpc_method_handler(serve, response_serializer=_serialized)


def _serialized(message: Message) -> bytes:
    return message.SerializeToString()
