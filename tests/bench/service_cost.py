"""What the service costs without a model: `python -m tests.bench.service_cost`.

Servers and load run in separate processes. First the service on the null engine: its CPU time per chunk at several
numbers of chunks per message, compared with gRPC alone with messages of the same sizes. Then the real engine with the
null runner: CPU time and latency of a thousand sessions that play in real time. CPU time is that of the server's
process, by thread, so it is valid on a machine that is also used by others; latency is not.
Prints tables; with --out writes service_cost.json and service_cost.md.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import statistics
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tests.bench.machine import busy_share, machine_facts
from tests.bench.null_load import Channels, Counts, Line, Paced, PacedResult, exchange, total
from tests.bench.null_process import NULL_SERVER, SETTINGS, NullServer, server_process

SIZES = (1, 10, 50, 200)
SESSIONS_IN_LOCKSTEP = 800
MOST_STREAMS = 200
"""Of the sessions in lockstep; enough of both to keep the server's caches warm and most of a core busy."""
CHUNK_FRAMES = 20
FLUSH_MS = 20.0
PLAYED = ((1000, 1), (1000, 4), (1000, 1000))
"""Numbers of sessions, and of streams that carry them."""
STAND_INS = "tests.bench.stand_ins"


@dataclass(frozen=True)
class ChunkCost:
    """The cost of a chunk in the service on the null engine. Sizes are means.

    cpu_us: CPU microseconds per chunk by thread, the median over trials; grpc_us: what gRPC alone takes for messages of
    these sizes. others: the share of the machine that other processes used meanwhile.
    """

    sessions_a_stream: int
    chunks_a_message: float
    frames_a_chunk: float
    request_bytes: int
    response_bytes: int
    chunks_per_s: float
    cpu_us: dict[str, float]
    grpc_us: float
    others: float

    @property
    def total_us(self) -> float:
        return sum(self.cpu_us.values())


@dataclass(frozen=True)
class Trials:
    """The trials of one server: totals of what was received, and CPU microseconds per chunk by thread in each trial."""

    counts: Counts
    seconds: float
    cpu_us: list[dict[str, float]]

    def median_us(self) -> dict[str, float]:
        return {name: statistics.median(used[name] for used in self.cpu_us) for name in self.cpu_us[0]}


def streams_of(sessions_a_stream: int) -> int:
    """How many streams advance in lockstep."""
    return min(MOST_STREAMS, SESSIONS_IN_LOCKSTEP // sessions_a_stream)


async def lockstep(server: NullServer, sessions_a_stream: int, frames: int, seconds: float, repeats: int) -> Trials:
    """Advance all sessions, `sessions_a_stream` of them on each stream."""
    channels = Channels(server.address)
    lines = [Line(channels, sessions_a_stream) for _ in range(streams_of(sessions_a_stream))]
    await asyncio.gather(*(line.open() for line in lines))
    await asyncio.gather(*(line.advance_for(0.5, frames) for line in lines))
    first, begun_s = total(lines), time.perf_counter()
    used = []
    for _ in range(repeats):
        before, cpu_before = total(lines), server.cpu_s()
        await asyncio.gather(*(line.advance_for(seconds, frames) for line in lines))
        used.append(used_us(cpu_before, server.cpu_s(), total(lines).minus(before).chunks))
    trials = Trials(total(lines).minus(first), time.perf_counter() - begun_s, used)
    for line in lines:
        line.cancel()
    await channels.close()
    return trials


def used_us(before: dict[str, float], after: dict[str, float], count: int) -> dict[str, float]:
    """CPU microseconds by thread, divided by `count`."""
    return {name: 1e6 * (after[name] - before[name]) / count for name in after}


async def bare_us(server: NullServer, streams: int, request_bytes: int, seconds: float, repeats: int) -> float:
    """Median CPU microseconds of an exchange of messages with a server that is gRPC alone."""
    channels = Channels(server.address)

    async def exchanged(seconds: float) -> int:
        return sum(
            await asyncio.gather(*(exchange(channels, request_bytes, FLUSH_MS / 1000, seconds) for _ in range(streams)))
        )

    await exchanged(0.5)
    used = []
    for _ in range(repeats):
        before = server.cpu_s()
        count = await exchanged(seconds)
        used.append(sum(used_us(before, server.cpu_s(), count).values()))
    await channels.close()
    return statistics.median(used)


def chunk_cost(sessions_a_stream: int, frames: int, seconds: float, repeats: int) -> ChunkCost:
    """The cost in the service, then in gRPC with messages as large as the service's were."""
    share = busy_share()
    with server_process(STAND_INS, "service", *SETTINGS, "--flush-ms", str(FLUSH_MS)) as server:
        trials = asyncio.run(lockstep(server, sessions_a_stream, frames, seconds, repeats))
    counts = trials.counts
    request_bytes = round(counts.request_bytes / counts.requests)
    response_bytes = round(counts.num_bytes / counts.messages)
    with server_process(STAND_INS, "grpc", str(response_bytes)) as server:
        streams = streams_of(sessions_a_stream)
        message_us = asyncio.run(bare_us(server, streams, request_bytes, seconds, repeats))
    return ChunkCost(
        sessions_a_stream,
        counts.chunks / counts.messages,
        counts.frames / counts.chunks,
        request_bytes,
        response_bytes,
        counts.chunks / trials.seconds,
        trials.median_us(),
        message_us * counts.messages / counts.chunks,
        share(),
    )


@dataclass(frozen=True)
class Latency:
    """With so many sessions in real time. (p50, p99, max) in ms; cpu_share: of a core, cpu_us: per chunk, by thread."""

    sessions: int
    streams: int
    flush_ms: float
    edit_ms: tuple[float, float, float]
    ping_ms: tuple[float, float, float]
    generator_lag_ms: tuple[float, float, float]
    edits: int
    unanswered: int
    chunks_a_message: float
    frames_a_chunk: float
    cpu_share: dict[str, float]
    cpu_us: dict[str, float]

    @property
    def void(self) -> bool:
        """Whether the figures do not count, because the generator was late itself or edits were never answered."""
        return self.generator_lag_ms[1] > 5.0 or self.unanswered > 0


async def latency(server: NullServer, sessions: int, streams: int, flush_ms: float, seconds: float) -> Latency:
    channels = Channels(server.address)
    lines = [Line(channels, sessions // streams) for _ in range(streams)]
    for first in range(0, streams, 50):
        await asyncio.gather(*(line.open() for line in lines[first : first + 50]))
    before, cpu_before, started_s = total(lines), server.cpu_s(), time.perf_counter()
    result: PacedResult = await Paced(lines).run(warm_up_s=2.0, seconds=seconds)
    cpu_after, elapsed_s, counts = server.cpu_s(), time.perf_counter() - started_s, total(lines).minus(before)
    for line in lines:
        line.cancel()
    await channels.close()
    return Latency(
        sessions,
        streams,
        flush_ms,
        milliseconds(result.edits_s),
        milliseconds(result.pings_s),
        milliseconds(result.lags_s),
        len(result.edits_s),
        result.unanswered,
        counts.chunks / counts.messages,
        counts.frames / counts.chunks,
        {name: (cpu_after[name] - cpu_before[name]) / elapsed_s for name in cpu_after},
        used_us(cpu_before, cpu_after, counts.chunks),
    )


def milliseconds(seconds: list[float]) -> tuple[float, float, float]:
    """p50, p99 and maximum. Raises RuntimeError if nothing was measured."""
    if not seconds:
        raise RuntimeError("nothing was measured: no answer came")
    p50, p99 = np.percentile(seconds, [50, 99]) * 1000
    return float(p50), float(p99), 1000 * max(seconds)


def markdown(facts: dict[str, str], costs: list[ChunkCost], latencies: list[Latency]) -> str:
    lines = [
        "The service on the null engine, processor time a chunk:",
        "",
        "| chunks a message | frames a chunk | KB a message | chunks/s | CPU us a chunk | event loop | null engine "
        "| gRPC's threads | gRPC alone, same messages | others used |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
        *(
            f"| {each.chunks_a_message:.1f} | {each.frames_a_chunk:.1f} | {each.response_bytes / 1000:.1f} "
            f"| {each.chunks_per_s:.0f} | {each.total_us:.1f} | {each.cpu_us['event loop']:.1f} "
            f"| {each.cpu_us['engine']:.1f} | {each.cpu_us['others']:.1f} | {each.grpc_us:.1f} | {each.others:.0%} |"
            for each in costs
        ),
        "",
        "The engine with the null runner and the service, sessions playing in real time:",
        "",
        "| sessions | streams | flush | chunks a message | frames a chunk | CPU us a chunk | event loop | engine "
        "| gRPC's threads | server CPU | ping p50 / p99 / max | edit to frame p50 / p99 / max | edits without answer "
        "| generator lag p99 |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for each in latencies:
        edit, ping = (" / ".join(f"{value:.1f}" for value in values) for values in (each.edit_ms, each.ping_ms))
        void = " (void)" * each.void
        lines.append(
            f"| {each.sessions} | {each.streams} | {each.flush_ms:g} ms | {each.chunks_a_message:.1f} "
            f"| {each.frames_a_chunk:.1f} | {sum(each.cpu_us.values()):.1f} | {each.cpu_us['event loop']:.1f} "
            f"| {each.cpu_us['engine']:.1f} | {each.cpu_us['others']:.1f} "
            f"| {100 * sum(each.cpu_share.values()):.0f} % of a core | {ping} ms | {edit} ms | {each.unanswered} "
            f"| {each.generator_lag_ms[1]:.1f} ms{void} |"
        )
    lines += ["", *(f"- {name}: {value}" for name, value in facts.items()), ""]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.service_cost", description=__doc__)
    parser.add_argument("--out", type=Path, help="folder to write to (default: print only)")
    parser.add_argument("--quick", action="store_true", help="short trials")
    parser.add_argument(
        "--sizes", type=int, nargs="*", default=list(SIZES), help="chunks per message (default: %(default)s)"
    )
    parser.add_argument(
        "--chunk-frames", type=int, nargs="*", default=[CHUNK_FRAMES], help="frames per chunk (default: %(default)s)"
    )
    parser.add_argument(
        "--played", type=int, nargs=2, action="append", metavar=("SESSIONS", "STREAMS"),
        help=f"numbers of sessions that play, and of their streams; may be repeated (default: {PLAYED})",
    )  # fmt: skip
    parser.add_argument("--flush-ms", type=float, nargs="*", default=[FLUSH_MS, 5.0], help="for the sessions that play")
    options = parser.parse_args()
    seconds, repeats, play_s = (1.0, 3, 5.0) if options.quick else (3.0, 3, 15.0)
    facts, costs, latencies = machine_facts(), [], []
    share = busy_share()
    for frames in options.chunk_frames:
        for size in sorted(options.sizes):
            costs.append(chunk_cost(size, frames, seconds, repeats))
            print(f"{size} chunks of {frames} frames a message: {costs[-1].total_us:.1f} us a chunk", flush=True)
    for flush_ms in options.flush_ms:
        for sessions, streams in PLAYED if options.played is None else options.played:
            with server_process(NULL_SERVER, *SETTINGS, "--flush-ms", str(flush_ms)) as server:
                latencies.append(asyncio.run(latency(server, sessions, streams, flush_ms, play_s)))
            print(f"{sessions} sessions on {streams} streams: ping {latencies[-1].ping_ms} ms", flush=True)
    facts["others used"] = f"{share():.0%} of the machine meanwhile"
    table = markdown(facts, costs, latencies)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        report = {"facts": facts, "chunks": [asdict(c) for c in costs], "latency": [asdict(each) for each in latencies]}
        (options.out / "service_cost.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        (options.out / "service_cost.md").write_text(table, encoding="utf-8")
    print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
