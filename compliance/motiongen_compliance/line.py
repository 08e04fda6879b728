"""Line: the TCP connections between a client and the server under test, which a test cuts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

_PIECE_BYTES = 65536


class Line:
    """Listens on a port of its own, `address`, and passes everything on to the server."""

    def __init__(self, server_address: str) -> None:
        host, _, port = server_address.rpartition(":")
        self._server = (host.strip("[]"), int(port))
        self._ends: set[asyncio.StreamWriter] = set()
        self._passing: set[asyncio.Task[None]] = set()
        self.address = ""

    def cut(self) -> None:
        """Abort every connection, as a network does that is gone; new ones are taken."""
        for end in self._ends:
            end.transport.abort()

    async def take(self, client: asyncio.StreamReader, to_client: asyncio.StreamWriter) -> None:
        """A new connection."""
        task = asyncio.current_task()
        assert task is not None
        self._passing.add(task)
        try:
            server, to_server = await asyncio.open_connection(*self._server)
        except OSError:
            to_client.transport.abort()
            return
        ends = {to_client, to_server}
        self._ends |= ends
        try:
            async with asyncio.TaskGroup() as ways:
                ways.create_task(_pass_on(client, to_server))
                ways.create_task(_pass_on(server, to_client))
        except* OSError:
            pass  # it was cut
        finally:
            self._ends -= ends
            for end in ends:
                end.transport.abort()

    async def end(self) -> None:
        """Cut what is left, and wait until it is gone."""
        self.cut()
        if self._passing:
            await asyncio.wait(self._passing)


async def _pass_on(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    while data := await source.read(_PIECE_BYTES):
        sink.write(data)
        await sink.drain()
    sink.write_eof()


@asynccontextmanager
async def a_line(server_address: str) -> AsyncIterator[Line]:
    """A line to a server for as long as the context is open."""
    line = Line(server_address)
    listener = await asyncio.start_server(line.take, "127.0.0.1", 0)
    line.address = f"127.0.0.1:{listener.sockets[0].getsockname()[1]}"
    try:
        yield line
    finally:
        listener.close()
        await line.end()
