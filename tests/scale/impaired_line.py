"""A line that is slow, stalls, falls silent or breaks when it is told to: a network, where there is no netem."""

from __future__ import annotations

import asyncio
import contextlib
import random

from motiongen_compliance.line import Carry, TcpLine

PIECE_BYTES = 16_384
STALL_SHARE = 0.02
"""Of pieces that wait as long as TCP does for one that was lost."""


class ImpairedLine(TcpLine):
    """delay_s: each way, up to twice as much by chance; order is kept, as by TCP. stall_s: what some wait besides.

    is_silent: nothing is passed on and nothing is closed, as of a machine that has lost its power.
    """

    name = "localhost"

    def __init__(self, behind: str, draw: random.Random) -> None:
        super().__init__(behind)
        self.delay_s = self.stall_s = 0.0
        self.is_silent = False
        self._draw = draw

    def heal(self) -> None:
        """As a good line. What was on its way while it was silent is lost with its connections."""
        if self.is_silent:
            self.cut()
        self.delay_s, self.stall_s, self.is_silent = 0.0, 0.0, False

    def carry(self) -> Carry:
        return self._carry

    async def _carry(self, source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
        """One way of a connection: what has been read waits its time, and what comes meanwhile is read on."""
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
