"""TcpLine: a TCP proxy that carries what its kind decides, and whose connections a test cuts."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from typing import Self

Carry = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
"""Takes bytes one way until their source ends, or this way is to end."""


class TcpLine(ABC):
    """Use as `async with`. address: where it listens; port: of the server behind it; is_shut: it aborts who comes."""

    name = "127.0.0.1"
    """Of this machine, as the address has it: certificates name hosts."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.is_shut = False
        self._open: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()

    @abstractmethod
    def carry(self) -> Carry:
        """How a new connection carries both of its ways."""

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.address = f"{self.name}:{self._server.sockets[0].getsockname()[1]}"
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
        task.add_done_callback(self._tasks.discard)
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
        carry = self.carry()
        ways = [asyncio.ensure_future(carry(reader, behind)), asyncio.ensure_future(carry(behind_reader, writer))]
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for end in pair:
            end.transport.abort()
        for way in ways:
            way.cancel()
        await asyncio.wait(ways)
        self._open -= pair
