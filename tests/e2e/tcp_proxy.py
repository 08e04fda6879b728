"""A TCP proxy that loses connections: after so many bytes, or when a test says so; or lets them fall silent."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

CHUNK_BYTES = 4096


class TcpProxy:
    """Use as `async with TcpProxy(port) as proxy`. address: where it listens; port: of the server behind it.

    budget: asked for each new connection; after so many bytes, both directions together, it is aborted; None: never.
    num_cuts: how many were. is_shut: new connections are aborted at once. is_silent: nothing is passed on any more.
    """

    def __init__(self, port: int, budget: Callable[[], int | None] = lambda: None) -> None:
        self.port = port
        self.num_cuts = 0
        self.is_shut = False
        self.is_silent = False
        self.budget = budget
        self._open: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> TcpProxy:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.address = f"127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.cut()
        if self._tasks:
            await asyncio.wait(self._tasks)

    def cut(self) -> None:
        """Abort every connection."""
        for writer in self._open:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        if self.is_shut:
            writer.transport.abort()
            return
        try:
            behind_reader, behind = await asyncio.open_connection("127.0.0.1", self.port)
        except OSError:
            writer.transport.abort()
            return
        pair = {writer, behind}
        self._open |= pair
        left = self.budget()

        async def pass_on(source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
            nonlocal left
            while data := await source.read(CHUNK_BYTES):
                if self.is_silent:
                    continue
                if left is not None and len(data) >= left:
                    target.write(data[:left])
                    self.num_cuts += 1
                    return
                left = None if left is None else left - len(data)
                target.write(data)
                await target.drain()

        ways = [asyncio.create_task(pass_on(reader, behind)), asyncio.create_task(pass_on(behind_reader, writer))]
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for end in pair:
            end.transport.abort()
        for way in ways:
            way.cancel()
        await asyncio.wait(ways)
        self._open -= pair
