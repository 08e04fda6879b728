"""Writes a response to a client that may not read, with a time limit."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine

from motiongen_server.rpc.calls.requests import look_at
from motiongen_server.rpc.errors.streams import reader_stuck

LAST_WRITE_S = 1.0
"""How much longer a write may take once it is given up or cancelled."""


async def write_within(limit_s: float, write: Coroutine[None, None, None]) -> None:
    """Await the write of a response, after which the call may be ended. Raises StreamRefused after limit_s.

    However the wait ends, the write itself goes on for a moment: gRPC takes no status while a call's first response
    is being written, so if the write were cancelled at once, the client would get no status.
    """
    writing = asyncio.ensure_future(write)
    writing.add_done_callback(look_at)
    try:
        await asyncio.wait({writing}, timeout=limit_s)
        if not writing.done():
            raise reader_stuck(limit_s)
    finally:
        if not writing.done():
            await asyncio.wait({writing}, timeout=LAST_WRITE_S)
            writing.cancel()
            await asyncio.gather(writing, return_exceptions=True)
    writing.result()
