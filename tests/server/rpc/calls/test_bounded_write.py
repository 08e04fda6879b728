"""Writes that are awaited for a limited time."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

from motiongen_server.rpc.calls.bounded_write import write_within

ENDLESS_S = 1e6


async def test_write_that_fails_as_its_call_is_cancelled_is_not_logged() -> None:
    logged: list[dict[str, Any]] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, context: logged.append(context))
    gone = asyncio.Event()

    async def write() -> None:
        await gone.wait()
        raise OSError("the client has gone")

    writing = asyncio.create_task(write_within(ENDLESS_S, write()))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    gone.set()
    await asyncio.sleep(0)  # the write has failed, and `write_within` does not know it yet
    writing.cancel()
    await asyncio.wait({writing})
    assert writing.cancelled()
    del writing
    gc.collect()  # a task whose exception was never retrieved logs it when it is collected
    assert logged == []
