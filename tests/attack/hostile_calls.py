"""Hostile clients whose calls hold places: without a request, or with unread answers; see `tests.attack.hostile`."""

from __future__ import annotations

import asyncio
import itertools
from contextlib import suppress
from typing import Any

from motiongen_server.rpc.handlers import SERVICE_NAME
from tests.attack.begun import begun
from tests.attack.calls import HELLO, channel_to, many
from tests.raw_calls import beginning, call_of

CONNECTIONS = 17
CALLS_OF_A_CONNECTION = 250
"""4,250 in total: more than there are places for all kinds of calls together."""
RETRY_S = 0.5
CHECK = "/grpc.health.v1.Health/Check"
HALF_OPEN = (f"/{SERVICE_NAME}/GetCatalog", CHECK, f"/{SERVICE_NAME}/GenerateClip", "/grpc.health.v1.Health/Watch")
UNREAD = (*HALF_OPEN, f"/{SERVICE_NAME}/StreamMotion")
NARROW = (("grpc.http2.lookahead_bytes", 5), ("grpc.http2.bdp_probe", 0))
"""The client's flow-control window: so small that no response fits."""


NAMES = (b"/\xff", b"/" + SERVICE_NAME.encode() + b"/\xc3\x28", f"/{SERVICE_NAME}/GetCatalog".encode())
BEHIND_THEM = (b"authorization", b"Bearer \xff\xfe")
CALLS_AT_ONCE, PAUSE_S = 100, 0.05


async def unreadable_names(address: str) -> None:
    """Calls of methods whose names are not text, and of an existing method, all with an invalid token."""
    host, _, port = address.rpartition(":")

    async def connection() -> None:
        reader, writer = await asyncio.open_connection(host, int(port))
        begun()
        reading = asyncio.create_task(_forget(reader))
        with suppress(ConnectionError):
            writer.write(beginning())
            calls = zip(itertools.count(1, 2), itertools.cycle(NAMES))
            while not reading.done():
                writer.write(b"".join(call_of(*call, BEHIND_THEM) for call in itertools.islice(calls, CALLS_AT_ONCE)))
                await writer.drain()
                await asyncio.sleep(PAUSE_S)
        reading.cancel()
        writer.close()

    await many(CONNECTIONS, connection)


async def _forget(reader: asyncio.StreamReader) -> None:
    """Read and discard everything until the server ends the connection."""
    with suppress(ConnectionError):
        while await reader.read(1 << 16):
            pass


async def half_open_calls(address: str) -> None:
    """Calls of methods that take one request, without the request: only headers are sent."""

    async def connection() -> None:
        async with channel_to(address) as channel:
            paths = itertools.islice(itertools.cycle(HALF_OPEN), CALLS_OF_A_CONNECTION)
            calls = [channel.stream_unary(path)() for path in paths]
            await asyncio.gather(*(call.code() for call in calls))
            await asyncio.sleep(RETRY_S)

    await many(CONNECTIONS, connection)


async def unread_calls(address: str) -> None:
    """Calls of all methods whose answers cannot be written: as many as get a place, again and again."""

    async def connection() -> None:
        async with channel_to(address, *NARROW) as channel:
            paths = itertools.cycle(UNREAD)
            calls: list[Any] = []
            while True:
                calls = [call for call in calls if not call.done()]
                for path in itertools.islice(paths, CALLS_OF_A_CONNECTION - len(calls)):
                    calls.append(channel.unary_stream(path)(HELLO if path == UNREAD[-1] else b""))
                await asyncio.sleep(RETRY_S)

    await many(CONNECTIONS, connection)
