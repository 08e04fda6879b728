"""Calls that clients cancel: memory that gRPC keeps in the gateway if a batch of operations is never completed."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from pathlib import Path

import grpc.aio
import pytest

from tests.attack.calls import HELLO, bare_stream, channel_to
from tests.attack.cycles import AT_ONCE, PARTS, STEP_BYTES, Readings
from tests.attack.in_use import told
from tests.attack.server import attacked
from tests.waiting import try_again

CALLS_EACH = 24
"""How many calls each of `AT_ONCE` clients makes in each part. The first some thousand fill caches: 100 KB in all."""
LOOKS = 10
"""How often memory in use is read; the least counts, since the last calls of a part may still be ending."""
MOST_BYTES = 48
"""Per call. A gRPC batch that is never completed takes 96 or more, a status with a message about 500."""
STORELESS = ("--snapshot-store", "none")
"""SQLite's cache grows by up to 2 MiB when the file that all tests' servers share is first looked through."""
UNBOUNDED = (*STORELESS, "--stream-events-per-second", "1000000", "--peer-calls-per-second", "1000000")
BOUNDED = (*STORELESS, "--stream-events-per-second", "1000000", "--peer-calls-per-second", "1")


async def give_up_unseen(channel: grpc.aio.Channel) -> None:
    """Cancel before the server has handled the call, which it refuses."""
    call = bare_stream(channel)
    with contextlib.suppress(grpc.aio.AioRpcError):
        await call.write(HELLO)
    call.cancel()


async def give_up_open(channel: grpc.aio.Channel) -> None:
    """Cancel while the server waits for the next message."""
    call = bare_stream(channel)
    await call.write(HELLO)
    await call.read()
    call.cancel()


@pytest.mark.parametrize(("settings", "give_up"), [(BOUNDED, give_up_unseen), (UNBOUNDED, give_up_open)])
async def test_cancelled_calls_leave_no_memory_in_use(
    tmp_path: Path, settings: tuple[str, ...], give_up: Callable[[grpc.aio.Channel], Awaitable[None]]
) -> None:
    async def several() -> None:
        for _ in range(CALLS_EACH):
            await give_up(channel)

    readings = Readings([], [])
    with (
        told() as in_use,
        attacked(tmp_path / "log", settings, environment=in_use.environment) as server,
    ):
        async with channel_to(server.address) as channel:
            for part in range(1, PARTS + 1):
                await asyncio.gather(*(several() for _ in range(AT_ONCE)))
                looks = []
                for _ in range(LOOKS):
                    await try_again()
                    looks.append(in_use.bytes_of(server.process.pid))
                readings.cycles.append(part * CALLS_EACH * AT_ONCE)
                readings.values.append([min(looks)])
    print(readings.slopes(STEP_BYTES))
    assert max(readings.slopes(STEP_BYTES)) < MOST_BYTES
    assert server.exit_code == 0
