"""A TCP relay that blocking tests can cut or freeze: a frozen relay reads bytes and passes none on."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from motiongen_compliance.line import Carry, TcpLine
from tests.waiting import LIMIT_S

PIECE_BYTES = 65536


class FreezingLine(TcpLine):
    """is_flowing: cleared while it is frozen."""

    def __init__(self, behind: str) -> None:
        super().__init__(behind)
        self.is_flowing = asyncio.Event()
        self.is_flowing.set()

    def carry(self) -> Carry:
        return self._carry

    async def _carry(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        while data := await source.read(PIECE_BYTES):
            await self.is_flowing.wait()
            sink.write(data)
            await sink.drain()


class BlockingLine:
    """Use it in a `with` statement: its event loop has its own thread. address: where it listens."""

    def __init__(self, behind: str) -> None:
        self._behind = behind
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)

    def cut(self) -> None:
        """Abort all connections; new ones are accepted."""
        self._call(self._line.cut)

    def freeze(self) -> None:
        """Pass nothing on from now on, on new connections too."""
        self._call(self._line.is_flowing.clear)

    def thaw(self) -> None:
        """Pass bytes on again."""
        self._call(self._line.is_flowing.set)

    def _call(self, function: Callable[[], None]) -> None:
        async def called() -> None:
            function()

        asyncio.run_coroutine_threadsafe(called(), self._loop).result(LIMIT_S)

    def __enter__(self) -> BlockingLine:
        self._thread.start()
        self._line = asyncio.run_coroutine_threadsafe(self._begun(), self._loop).result(LIMIT_S)
        self.address = self._line.address
        return self

    async def _begun(self) -> FreezingLine:
        return await FreezingLine(self._behind).__aenter__()

    def __exit__(self, *_: object) -> None:
        asyncio.run_coroutine_threadsafe(self._line.__aexit__(), self._loop).result(LIMIT_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(LIMIT_S)
        self._loop.close()
