"""TcpLine: a TCP relay in front of a server, whose connections a test can cut."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Self

_PIECE_BYTES = 65536

Carry = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
"""Copies bytes in one direction until the source ends. When one direction returns, the connection ends."""


class TcpLine:
    """A relay, as `async with`. address: where it listens; behind: the server; is_shut: abort new connections."""

    name = "127.0.0.1"
    """The host in `address`. TLS certificates are checked against it."""

    def __init__(self, behind: str) -> None:
        self.behind = behind
        self.address = ""
        self.is_shut = False
        self._open: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()

    def carry(self) -> Carry:
        """How a new connection copies bytes in each direction. Here: unchanged, as they arrive."""
        return _pass_on

    def cut(self) -> None:
        """Abort every connection, as if the network were lost. New connections are accepted."""
        for writer in self._open:
            writer.transport.abort()

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.address = f"{self.name}:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.cut()
        if self._tasks:
            await asyncio.wait(self._tasks)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        if self.is_shut:
            writer.transport.abort()
            return
        host, _, port = self.behind.rpartition(":")
        try:
            behind_reader, behind = await asyncio.open_connection(host.strip("[]"), int(port))
        except OSError:
            writer.transport.abort()
            return
        pair = {writer, behind}
        self._open |= pair
        carry = self.carry()
        ways = [asyncio.ensure_future(carry(reader, behind)), asyncio.ensure_future(carry(behind_reader, writer))]
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for end in pair:
            end.transport.abort()
        for way in ways:
            way.cancel()
        ended = await asyncio.gather(*ways, return_exceptions=True)
        self._open -= pair
        for failure in ended:
            if isinstance(failure, Exception) and not isinstance(failure, OSError):  # else it was cut
                raise failure


async def _pass_on(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    while data := await source.read(_PIECE_BYTES):
        sink.write(data)
        await sink.drain()
