"""Common parts of hostile clients: repeated calls with raw bytes as messages, over many connections."""

from __future__ import annotations

import asyncio
import itertools
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.rpc.handlers import SERVICE_NAME
from tests.attack.begun import begun, has_begun
from tests.attack.tokens import TOKEN_VARIABLE, bearer

Request = service_pb2.StreamMotionRequest
Event = session_pb2.SessionEvent
HELLO = Request(hello=service_pb2.ClientHello(client_agent="hostile")).SerializeToString()
OPTIONS = (("grpc.use_local_subchannel_pool", 1), ("grpc.max_receive_message_length", 8 << 20))
STREAMS = 8


def _showing(details: Any, token: str) -> Any:
    """A call's details, with a token added to its metadata."""
    return details._replace(metadata=(*(details.metadata or ()), *bearer(token)))


class _ShowingOnStreams(grpc.aio.StreamStreamClientInterceptor):  # type: ignore[misc]  # grpcio has no types for it
    """Sends a token with every stream of a connection."""

    def __init__(self, token: str) -> None:
        self._token = token

    async def intercept_stream_stream(self, continuation: Any, details: Any, requests: Any) -> Any:
        return await continuation(_showing(details, self._token), requests)


class _ShowingOnClips(grpc.aio.UnaryStreamClientInterceptor):  # type: ignore[misc]  # grpcio has no types for it
    """The same for calls with a response stream."""

    def __init__(self, token: str) -> None:
        self._token = token

    async def intercept_unary_stream(self, continuation: Any, details: Any, request: Any) -> Any:
        return await continuation(_showing(details, self._token), request)


@asynccontextmanager
async def channel_to(address: str, *more: tuple[str, int]) -> AsyncIterator[grpc.aio.Channel]:
    """A new connection that sends the hostile clients' token, if they have one, with streams and clips.

    The first established connection reports that the attack has begun. more: options.
    """
    token = os.environ.get(TOKEN_VARIABLE, "")
    showing = [_ShowingOnStreams(token), _ShowingOnClips(token)] if token else []
    async with grpc.aio.insecure_channel(address, options=(*OPTIONS, *more), interceptors=showing) as channel:
        telling = None if has_begun() else asyncio.create_task(_tell(channel))
        try:
            yield channel
        finally:
            if telling is not None:
                telling.cancel()
                await asyncio.gather(telling, return_exceptions=True)


async def _tell(channel: grpc.aio.Channel) -> None:
    """Report it once the connection has reached an HTTP/2 server; some attacks have no answer to wait for."""
    await channel.channel_ready()
    begun()


def bare_stream(channel: grpc.aio.Channel) -> Any:
    """A stream with raw bytes as messages."""
    return channel.stream_stream(f"/{SERVICE_NAME}/StreamMotion")()


async def for_ever(act: Callable[[], Awaitable[None]]) -> None:
    """Call `act` again and again, whatever the server answers."""
    while True:
        try:
            await act()
        except (grpc.aio.AioRpcError, asyncio.InvalidStateError, OSError):
            await asyncio.sleep(0.05)


async def many(count: int, act: Callable[[], Awaitable[None]]) -> None:
    await asyncio.gather(*(for_ever(act) for _ in range(count)))


async def drain(call: Any) -> None:
    """Read and discard everything."""
    while await call.read() is not grpc.aio.EOF:
        pass


async def flood(address: str, messages: list[bytes], reads: bool = True, streams: int = STREAMS) -> None:
    """Send the same messages on each of some streams, with a connection each."""

    async def once() -> None:
        async with channel_to(address) as channel:
            call = bare_stream(channel)
            await call.write(HELLO)
            reading = asyncio.create_task(drain(call)) if reads else None
            try:
                for message in itertools.cycle(messages):
                    await call.write(message)
            finally:
                if reading is not None:
                    reading.cancel()
                    await asyncio.gather(reading, return_exceptions=True)

    await many(streams, once)
