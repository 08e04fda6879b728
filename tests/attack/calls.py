"""What hostile clients have in common: calls whose messages are bytes, again and again, over many connections."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable
from typing import Any

import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.rpc.handlers import SERVICE_NAME

Request = service_pb2.StreamMotionRequest
Event = session_pb2.SessionEvent
HELLO = Request(hello=service_pb2.ClientHello(client_agent="hostile")).SerializeToString()
OPTIONS = (("grpc.use_local_subchannel_pool", 1), ("grpc.max_receive_message_length", 8 << 20))
STREAMS = 8


def channel_to(address: str) -> grpc.aio.Channel:
    return grpc.aio.insecure_channel(address, options=OPTIONS)


def bare_stream(channel: grpc.aio.Channel) -> Any:
    """A stream of messages as they are."""
    return channel.stream_stream(f"/{SERVICE_NAME}/StreamMotion")()


async def for_ever(act: Callable[[], Awaitable[None]]) -> None:
    """Again and again, whatever the server says to it."""
    while True:
        try:
            await act()
        except (grpc.aio.AioRpcError, asyncio.InvalidStateError, OSError):
            await asyncio.sleep(0.05)


async def many(count: int, act: Callable[[], Awaitable[None]]) -> None:
    await asyncio.gather(*(for_ever(act) for _ in range(count)))


async def drain(call: Any) -> None:
    """Read and forget."""
    while await call.read() is not grpc.aio.EOF:
        pass


async def flood(address: str, messages: list[bytes], reads: bool = True, streams: int = STREAMS) -> None:
    """The same messages on each of some streams, over a connection each."""

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
