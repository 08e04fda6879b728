"""A TCP proxy that aborts connections after a number of bytes or on request, or stops forwarding their bytes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from motiongen_compliance.line import Carry, TcpLine

CHUNK_BYTES = 4096


class TcpProxy(TcpLine):
    """budget: called for each new connection, which is aborted after so many bytes in both directions; None: never.

    num_cuts: how many were aborted. is_silent: nothing is passed on any more.
    """

    def __init__(self, behind: str, budget: Callable[[], int | None] = lambda: None) -> None:
        super().__init__(behind)
        self.num_cuts = 0
        self.is_silent = False
        self.budget = budget

    def carry(self) -> Carry:
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

        return pass_on
