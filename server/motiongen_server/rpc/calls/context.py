"""CallContext: a call of gRPC whose request is awaited for a while, and that is counted until it is really over."""

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
"""It takes gRPC to tell that a client has gone before its call was looked at, by cancelling what serves it. Of a status
that nobody takes gRPC never gives back the memory (grpc/grpc#43360, ADR 87)."""


class CallContext:
    """What gRPC gives a method, but for what is waited for.

    A client can keep what is written to it from ever being written, by HTTP/2's flow control. gRPC then takes no status
    either, and the call holds a place of the server's until its connection ends. So what is written is never given up
    here, and `end` is not reached before: who holds places counts them.
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
        """Give that back once the call is over."""
        self._held.callback(give_back)

    def end(self) -> None:
        """gRPC is done with the call."""
        self._held.close()

    async def request(self, most_bytes: int | None = SMALL_REQUEST_BYTES, arrive: Arrive | None = None) -> bytes:
        """The one request, as `Requests.only`. Raises StreamRefused where it does not come, or is too long."""
        return await self._requests.only(self._context, most_bytes, arrive)

    async def read(self) -> Any:
        """The next of several. It is read on where this is cancelled."""
        self._reading = asyncio.ensure_future(self._context.read())
        self._reading.add_done_callback(look_at)
        return await asyncio.shield(self._reading)

    async def write(self, message: Message) -> None:
        """It is written on where this is cancelled."""
        self._writing = asyncio.ensure_future(self._context.write(message))
        self._writing.add_done_callback(look_at)
        await asyncio.shield(self._writing)

    async def abort_with_status(self, status: grpc.Status) -> NoReturn:
        """End the call, after what is being written."""
        await self.abort(status.code, status.details or "", status.trailing_metadata or ())

    async def abort(self, code: grpc.StatusCode, details: str = "", trailing_metadata: Any = ()) -> NoReturn:
        """End the call, after what is being written."""
        if self._writing is not None:
            await asyncio.wait({self._writing})
        await end_with(self._context, code, details, trailing_metadata)


async def end_with(context: Context, code: grpc.StatusCode, details: str, trailing_metadata: Any = ()) -> NoReturn:
    """End a call with a status. Where its client has gone there is nobody to be told, and nothing to be logged."""
    await asyncio.sleep(SEEN_GONE_S)
    try:
        await context.abort(code, details, trailing_metadata)
    except CLIENT_GONE as error:
        raise asyncio.CancelledError from error


async def refuse(context: Context, refusal: StreamRefused) -> NoReturn:
    """End a call with a refusal, as `end_with`."""
    status = refusal.status()
    await end_with(context, status.code, status.details or "", status.trailing_metadata or ())


def unary_method(
    answer: Callable[[CallContext], Awaitable[Message]], requests: Requests
) -> grpc.RpcMethodHandler[Any, Any]:
    """A method of one request and one response. It may raise StreamRefused."""

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
    """A method that writes its responses. It may raise StreamRefused."""

    async def serve(_messages: object, context: Context) -> None:
        call = CallContext(context, requests)
        status: grpc.Status | None = None
        try:
            try:
                await respond(call)
            except StreamRefused as refusal:
                # Without what it was raised through, which would keep the request until the status is taken.
                status = refusal.with_traceback(None).status()
            except grpc.aio.InternalError as error:  # of a write whose client has gone meanwhile: no fault of ours
                raise asyncio.CancelledError from error
            if status is not None:
                await call.abort_with_status(status)
        finally:
            call.end()

    return grpc.stream_stream_rpc_method_handler(serve, response_serializer=_serialized)


def _serialized(message: Message) -> bytes:
    return message.SerializeToString()
