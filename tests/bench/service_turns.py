"""What a chunk costs the service before and after a change: `python -m tests.bench.service_turns --before COMMIT`.

Compares the service on the null engine, as in `tests.bench.service_cost`, of several revisions, and gRPC alone with
messages of the same sizes, each in its own process. All run at the same time and are measured alternately, for some
seconds each, in an order that is reversed every round, so that other work on the machine affects all alike. Reported
for each are the best round, which was disturbed least, and the median.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import sys
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import Protocol

from tests.bench.machine import ROOT, busy_share, machine_facts
from tests.bench.null_load import Channels, Line, exchange, total
from tests.bench.null_process import SETTINGS, NullServer, server_process
from tests.bench.revision import Revision, commit_tree
from tests.bench.service_cost import CHUNK_FRAMES, FLUSH_MS, STAND_INS, streams_of, used_us

PARTS = ("event loop", "engine", "others")
TREE = Revision("the tree", ROOT)


class Measured(Protocol):
    """Something that is put under load repeatedly."""

    async def load(self, seconds: float) -> int:
        """Put it under load for so long. Returns the number of chunks."""
        ...


@dataclass
class Service:
    """The sessions of a service, which all advance together."""

    lines: list[Line]
    chunk_frames: int

    async def load(self, seconds: float) -> int:
        before = total(self.lines).chunks
        await asyncio.gather(*(line.advance_for(seconds, self.chunk_frames) for line in self.lines))
        return total(self.lines).chunks - before


@dataclass
class Alone:
    """Messages with gRPC alone, each as large as the service's with so many chunks."""

    channels: Channels
    streams: int
    request_bytes: int
    chunks_a_message: float

    async def load(self, seconds: float) -> int:
        exchanges = (exchange(self.channels, self.request_bytes, FLUSH_MS / 1000, seconds) for _ in range(self.streams))
        return round(self.chunks_a_message * sum(await asyncio.gather(*exchanges)))


@dataclass
class Contender:
    """rounds: CPU microseconds per chunk by thread, of each round."""

    name: str
    server: NullServer
    measured: Measured
    rounds: list[dict[str, float]] = field(default_factory=list)

    async def go_round(self, seconds: float) -> None:
        """Measure another round, after a moment of load that warms its caches."""
        await self.measured.load(seconds / 4)
        before = self.server.cpu_s()
        chunks = await self.measured.load(seconds)
        self.rounds.append(used_us(before, self.server.cpu_s(), chunks))

    @property
    def best(self) -> dict[str, float]:
        """The cheapest round."""
        return min(self.rounds, key=lambda used: sum(used.values()))

    @property
    def median_us(self) -> float:
        """The median of all threads together."""
        return statistics.median(sum(used.values()) for used in self.rounds)


@asynccontextmanager
async def service(server: NullServer, sessions_a_stream: int, chunk_frames: int) -> AsyncIterator[Service]:
    channels = Channels(server.address)
    lines = [Line(channels, sessions_a_stream) for _ in range(streams_of(sessions_a_stream))]
    await asyncio.gather(*(line.open() for line in lines))
    yield Service(lines, chunk_frames)
    for line in lines:
        line.cancel()
    await channels.close()


async def turns(
    servers: list[tuple[str, NullServer]], stack: ExitStack, size: int, chunk_frames: int, seconds: float, rounds: int
) -> list[Contender]:
    """The results of `servers`, then of gRPC alone, measured alternately."""
    async with AsyncExitStack() as opened:
        contenders = [
            Contender(name, server, await opened.enter_async_context(service(server, size, chunk_frames)))
            for name, server in servers
        ]
        first = contenders[0].measured
        assert isinstance(first, Service)
        begun = total(first.lines)
        await first.load(seconds)
        counts = total(first.lines).minus(begun)
        response_bytes = round(counts.num_bytes / counts.messages)
        server = stack.enter_context(server_process(STAND_INS, "grpc", str(response_bytes)))
        channels = Channels(server.address)
        request_bytes = round(counts.request_bytes / counts.requests)
        alone = Alone(channels, streams_of(size), request_bytes, counts.chunks / counts.messages)
        contenders.append(Contender("gRPC alone", server, alone))
        for number in range(rounds):
            for contender in contenders if number % 2 == 0 else reversed(contenders):
                await contender.go_round(seconds)
        await channels.close()
        return contenders


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.service_turns", description=__doc__)
    parser.add_argument("--before", nargs="*", default=[], metavar="COMMIT", help="also measure these")
    parser.add_argument("--size", type=int, default=50, help="chunks per message (default: %(default)s)")
    parser.add_argument("--chunk-frames", type=int, default=CHUNK_FRAMES, help="default: %(default)s")
    parser.add_argument("--seconds", type=float, default=2.0, help="duration of a turn (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    share, begun_s = busy_share(), time.monotonic()
    with ExitStack() as stack:
        revisions = [stack.enter_context(commit_tree(commit)) for commit in options.before]
        arguments = ("service", *SETTINGS, "--flush-ms", str(FLUSH_MS))
        servers = [
            (revision.name, stack.enter_context(server_process(STAND_INS, *arguments, revision=revision)))
            for revision in (*revisions, TREE)
        ]
        found = asyncio.run(turns(servers, stack, options.size, options.chunk_frames, options.seconds, options.rounds))
    print("| processor time a chunk, us | best | median | event loop | null engine | gRPC's threads |")
    print("|---|---:|---:|---:|---:|---:|")
    for contender in found:
        best = contender.best
        parts = " | ".join(f"{best[part]:.1f}" for part in PARTS)
        print(f"| {contender.name} | {sum(best.values()):.1f} | {contender.median_us:.1f} | {parts} |")
    facts = machine_facts() | {
        "chunks": f"{options.size} a message, of {options.chunk_frames} frames",
        "others used": f"{share():.0%} of the machine in {time.monotonic() - begun_s:.0f} s",
    }
    print("", *(f"- {name}: {value}" for name, value in facts.items()), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
