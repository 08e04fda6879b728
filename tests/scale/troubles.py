"""Temporary faults: of the network, of processes, and of a machine's disk, descriptors and clock."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import resource
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.scale.impaired_line import ImpairedLine
from tests.scale.proxies import Proxy
from tests.scale.replicas import Replica, Replicas

FULL_DISK_BYTES = 4096
FEW_DESCRIPTORS = 16
"""Fewer descriptors than each process of a server has open, but more than any of its poll(2) calls waits for.

A poll for more descriptors than the limit allows fails with EINVAL, on which ZeroMQ aborts; that would not happen to a
process that has merely used up its descriptors.
"""
STOPPED_S = 5.0
_SITE = """
import os, time
_true, _true_ns = time.time, time.time_ns
_file = os.open({path!r}, os.O_RDONLY | os.O_CLOEXEC)  # kept open: there may be no descriptor when it is asked for
def _offset_s():
    return int(os.pread(_file, 16, 0) or 0)
time.time = lambda: _true() + _offset_s()
time.time_ns = lambda: _true_ns() + 1_000_000_000 * _offset_s()
"""


@dataclass
class World:
    """The whole setup. line: between clients and the proxy. clock: a file with the offset of the servers' clock."""

    replicas: Replicas
    proxy: Proxy
    line: ImpairedLine
    clock: Path

    def one(self, draw: random.Random) -> Replica:
        """A server that has sessions."""
        return draw.choice(
            [each for each in self.replicas.all if each.metric("motiongen_sessions")] or self.replicas.all
        )


Trouble = Callable[[World, random.Random], AbstractAsyncContextManager[str]]
"""A fault that lasts as long as the block; yields what was hit."""


def false_clock(folder: Path) -> tuple[Path, dict[str, str]]:
    """A file with the offset of the wall clock, seconds, and an environment for Python programs that use it.

    Setting the machine's own clock would affect everything else. Libraries in C still read the true clock.
    """
    path, place = folder / "clock", folder / "clock-site"
    path.write_text("0")
    place.mkdir()
    (place / "sitecustomize.py").write_text(_SITE.format(path=str(path)))
    return path, {"PYTHONPATH": f"{place}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}


@asynccontextmanager
async def delay(world: World, draw: random.Random) -> AsyncIterator[str]:
    world.line.delay_s = draw.uniform(0.02, 0.15)
    yield f"{1000 * world.line.delay_s:.0f} ms each way"
    world.line.heal()


@asynccontextmanager
async def loss(world: World, draw: random.Random) -> AsyncIterator[str]:
    """Packet loss as seen through TCP: order is kept, and lost data arrives a time-out later."""
    world.line.delay_s, world.line.stall_s = 0.01, draw.uniform(0.2, 0.8)
    yield f"stalls of {1000 * world.line.stall_s:.0f} ms"
    world.line.heal()


@asynccontextmanager
async def half_open(world: World, _: random.Random) -> AsyncIterator[str]:
    world.line.is_silent = True
    yield "nothing is passed on, nothing closed"
    world.line.heal()


@asynccontextmanager
async def cut(world: World, _: random.Random) -> AsyncIterator[str]:
    world.line.cut()
    yield "every connection"


@asynccontextmanager
async def _stopped(pid: int, name: str) -> AsyncIterator[str]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield name
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


@asynccontextmanager
async def stopped_gateway(world: World, draw: random.Random) -> AsyncIterator[str]:
    replica = await asyncio.to_thread(world.one, draw)
    assert replica.process is not None
    async with _stopped(replica.process.pid, replica.name) as name:
        yield name


@asynccontextmanager
async def stopped_engine(world: World, draw: random.Random) -> AsyncIterator[str]:
    replica = await asyncio.to_thread(world.one, draw)
    async with _stopped(replica.engine().pid, replica.name) as name:
        yield name


@asynccontextmanager
async def stopped_redis(world: World, _: random.Random) -> AsyncIterator[str]:
    assert world.replicas.redis is not None
    async with _stopped(world.replicas.redis.pid, "Redis") as name:
        yield name


@asynccontextmanager
async def _limited(replica: Replica, what: int, most: int) -> AsyncIterator[str]:
    """Limit a resource of a server's processes."""
    assert replica.process is not None
    pids = replica.process.pid, replica.engine().pid
    before = [resource.prlimit(pid, what) for pid in pids]
    for pid, (_, hard) in zip(pids, before, strict=True):
        resource.prlimit(pid, what, (most, hard))
    try:
        yield replica.name
    finally:
        for pid, limits in zip(pids, before, strict=True):
            with contextlib.suppress(ProcessLookupError):
                resource.prlimit(pid, what, limits)


@asynccontextmanager
async def full_disk(world: World, draw: random.Random) -> AsyncIterator[str]:
    """No file of a server can grow."""
    async with _limited(await asyncio.to_thread(world.one, draw), resource.RLIMIT_FSIZE, FULL_DISK_BYTES) as name:
        yield name


@asynccontextmanager
async def no_descriptors(world: World, draw: random.Random) -> AsyncIterator[str]:
    """A server cannot open any more descriptors, while its clients' connections are cut, so that they need new ones."""
    replica = await asyncio.to_thread(world.one, draw)
    async with _limited(replica, resource.RLIMIT_NOFILE, FEW_DESCRIPTORS) as name:
        world.line.cut()
        yield name


@asynccontextmanager
async def jumped_clock(world: World, draw: random.Random) -> AsyncIterator[str]:
    offset_s = draw.choice((3600, -3600, 90_000))
    world.clock.write_text(str(offset_s))
    yield f"{offset_s:+d} s for all servers"
    world.clock.write_text("0")


TROUBLES: dict[str, Trouble] = {
    "delay": delay,
    "loss": loss,
    "half-open": half_open,
    "cut": cut,
    "gateway stopped": stopped_gateway,
    "engine stopped": stopped_engine,
    "redis stopped": stopped_redis,
    "disk full": full_disk,
    "no descriptors": no_descriptors,
    "clock jumps": jumped_clock,
}
