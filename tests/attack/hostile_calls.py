"""Hostile clients whose calls hold places: begun and not asked, answered and not read; see `tests.attack.hostile`."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

from motiongen_server.rpc.handlers import SERVICE_NAME
from tests.attack.calls import HELLO, channel_to, many

CONNECTIONS = 17
CALLS_OF_A_CONNECTION = 250
"""4,250 in all: more than there are places for all kinds of calls together."""
RETRY_S = 0.5
CHECK = "/grpc.health.v1.Health/Check"
HALF_OPEN = (f"/{SERVICE_NAME}/GetCatalog", CHECK, f"/{SERVICE_NAME}/GenerateClip", "/grpc.health.v1.Health/Watch")
UNREAD = (*HALF_OPEN, f"/{SERVICE_NAME}/StreamMotion")
NARROW = (("grpc.http2.lookahead_bytes", 5), ("grpc.http2.bdp_probe", 0))
"""Of what it has not read yet, a client lets the server send so few bytes: less than any response has."""


async def half_open_calls(address: str) -> None:
    """Calls of methods that take one request, of which only the headers are sent."""

    async def connection() -> None:
        async with channel_to(address) as channel:
            paths = itertools.islice(itertools.cycle(HALF_OPEN), CALLS_OF_A_CONNECTION)
            calls = [channel.stream_unary(path)() for path in paths]
            await asyncio.gather(*(call.code() for call in calls))
            await asyncio.sleep(RETRY_S)

    await many(CONNECTIONS, connection)


async def unread_calls(address: str) -> None:
    """Calls of all methods, whose answers cannot be written: as many as get a place, again and again."""

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
