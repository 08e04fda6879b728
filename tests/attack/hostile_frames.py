"""Hostile clients that send HTTP/2 frames as no gRPC library does; see `tests.attack.hostile`."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterator
from contextlib import suppress

from motiongen_server.rpc.handlers import SERVICE_NAME
from tests.attack.begun import begun
from tests.attack.broken_frames import (
    ACK,
    CALLED,
    CONTINUATION,
    FORBIDDEN,
    NEEDLESS,
    PING,
    RST_STREAM,
    UNSERVED,
    number,
)
from tests.attack.calls import many
from tests.raw_calls import END_OF_HEADERS, END_OF_STREAM, HEADERS, SETTINGS, beginning, call_of, frame

CONNECTIONS = 4
PAUSE_S = 0.02
RESETS_A_SECOND = 10_000
"""On all connections together."""
NEEDLESS_A_SECOND = 20_000
"""On all connections together."""
MOST_BEHIND_S = 1.0
"""A machine that is further behind than this skips frames."""
ANSWER_S = 0.05
"""The time in which the server should end a connection that sent a forbidden frame."""
HEADERS_A_CALL = 90_000
HEADERS_A_SECOND = 1_500_000
"""On each connection; each takes one byte."""
CALLS_UNHEEDED = 200
"""On each connection. gRPC accepts about 250 from a client that has not acknowledged its settings."""
BLOCK_BYTES = 1 << 14
CANCEL = number(8)
METHODS = (
    *(f"/{SERVICE_NAME}/{name}".encode() for name in ("StreamMotion", "GetCatalog", "GenerateClip")),
    UNSERVED,
)
FRAME_HEAD_BYTES = 9


async def resets(address: str) -> None:
    """Calls that are reset as soon as they begin, on few connections."""

    def said() -> Iterator[bytes]:
        calls = zip(itertools.count(1, 2), itertools.cycle(METHODS), strict=False)
        for count in at_once(RESETS_A_SECOND):
            begun_now = itertools.islice(calls, count)
            yield b"".join(call_of(stream, path) + frame(RST_STREAM, 0, stream, CANCEL) for stream, path in begun_now)

    await many(CONNECTIONS, lambda: speak(address, said()))


async def needless_frames(address: str) -> None:
    """Frames that are allowed at any time and have no, or hardly any, effect."""

    def said() -> Iterator[bytes]:
        frames = itertools.cycle(NEEDLESS)
        yield call_of(CALLED, UNSERVED)
        for count in at_once(NEEDLESS_A_SECOND):
            yield b"".join(itertools.islice(frames, count))

    await many(CONNECTIONS, lambda: speak(address, said()))


async def tiny_headers(address: str) -> None:
    """Calls with very many one-byte headers, from clients that never acknowledge the limit of headers.

    Each connection makes about as many calls as gRPC accepts without that.
    """
    more = b"\x40\x01k\x01v" + b"\xbe" * HEADERS_A_CALL  # added to the table once, then referred to by its index

    def call(stream: int, path: bytes) -> bytes:
        block = call_of(stream, path)[FRAME_HEAD_BYTES:] + more
        parts = [block[at : at + BLOCK_BYTES] for at in range(0, len(block), BLOCK_BYTES)]
        first, *others = parts
        frames = [frame(HEADERS, END_OF_STREAM, stream, first)]
        frames += [frame(CONTINUATION, 0, stream, part) for part in others]
        return b"".join([*frames, frame(CONTINUATION, END_OF_HEADERS, stream, b"")])

    def said() -> Iterator[bytes]:
        streams = range(1, 2 * CALLS_UNHEEDED, 2)
        return (call(*each) for each in zip(streams, itertools.cycle(METHODS), strict=False))

    pause_s = HEADERS_A_CALL / HEADERS_A_SECOND
    await many(CONNECTIONS, lambda: speak(address, said(), pause_s, heeds_settings=False))


async def forbidden_frames(address: str) -> None:
    """Forbidden frames, each on a connection of its own, after a call."""
    forbidden = itertools.cycle(FORBIDDEN)

    async def once() -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(ANSWER_S):
                await speak(address, iter([call_of(CALLED, UNSERVED) + next(forbidden)]), 2 * ANSWER_S)

    async def connections() -> None:
        while True:
            await once()

    await many(CONNECTIONS, connections)


def at_once(a_second: float) -> Iterator[int]:
    """How many frames one connection sends in each period, if all of them together send a_second."""
    owed = 0.0
    while True:
        owed += PAUSE_S * a_second / CONNECTIONS
        yield int(owed)
        owed -= int(owed)


async def speak(address: str, said: Iterator[bytes], pause_s: float = PAUSE_S, *, heeds_settings: bool = True) -> None:
    """Use one connection until the server ends it, or everything is sent. said: batches, one every pause_s seconds.

    heeds_settings: whether the client acknowledges the server's settings.
    """
    host, _, port = address.rpartition(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    begun()
    answering = asyncio.create_task(_answer(reader, writer, heeds_settings))
    clock = asyncio.get_running_loop().time
    due_s = clock()
    try:
        writer.write(beginning())
        for batch in said:
            writer.write(batch)
            await writer.drain()
            due_s = max(due_s + pause_s, clock() - MOST_BEHIND_S)
            await asyncio.wait({answering}, timeout=max(0.0, due_s - clock()))
            if answering.done():
                break
    finally:
        answering.cancel()
        writer.transport.abort()


async def _answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, heeds_settings: bool) -> None:
    """Answer the server's pings and settings until it ends the connection."""
    with suppress(ConnectionError, asyncio.IncompleteReadError):
        while True:
            head = await reader.readexactly(FRAME_HEAD_BYTES)
            content = await reader.readexactly(int.from_bytes(head[:3], "big"))
            kind, flags = head[3:5]
            if kind == PING and not flags & ACK:
                writer.write(frame(PING, ACK, 0, content))
            elif kind == SETTINGS and not flags & ACK and heeds_settings:
                writer.write(frame(SETTINGS, ACK, 0, b""))
