"""A relay that is slow, stalls, falls silent or breaks on command: an impaired network without netem."""

from __future__ import annotations

import asyncio
import contextlib
import random

from motiongen_compliance.line import Carry, TcpLine

PIECE_BYTES = 16_384
STALL_SHARE = 0.02
"""The share of pieces of data that are delayed as long as TCP's retransmission of a lost one."""


class ImpairedLine(TcpLine):
    """delay_s: in each direction, at random up to twice as much; order is kept, as by TCP. stall_s: extra delay of some
    pieces.

    is_silent: nothing is passed on and nothing is closed, as if a machine had lost power.
    """

    name = "localhost"

    def __init__(self, behind: str, draw: random.Random) -> None:
        super().__init__(behind)
        self.delay_s = self.stall_s = 0.0
        self.is_silent = False
        self._draw = draw

    def heal(self) -> None:
        """Work normally again. Connections that existed while it was silent are closed, with the data on its way."""
        if self.is_silent:
            self.cut()
        self.delay_s, self.stall_s, self.is_silent = 0.0, 0.0, False

    def carry(self) -> Carry:
        return self._carry

    async def _carry(self, source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
        """One direction of a connection: data that was read is delayed, while more is being read."""
        under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(64)
        putting = asyncio.create_task(self._put(under_way, target))
        try:
            last_s = 0.0
            with contextlib.suppress(OSError):
                while data := await source.read(PIECE_BYTES):
                    last_s = max(last_s, asyncio.get_running_loop().time() + self._wait_s())
                    await under_way.put((last_s, data))
        finally:
            putting.cancel()
            await asyncio.wait({putting})

    def _wait_s(self) -> float:
        stall_s = self.stall_s if self._draw.random() < STALL_SHARE else 0.0
        return self.delay_s * (1 + self._draw.random()) + stall_s

    async def _put(self, under_way: asyncio.Queue[tuple[float, bytes]], target: asyncio.StreamWriter) -> None:
        while True:
            due_s, data = await under_way.get()
            await asyncio.sleep(max(0.0, due_s - asyncio.get_running_loop().time()))
            if not self.is_silent:
                target.write(data)
                with contextlib.suppress(OSError):
                    await target.drain()
