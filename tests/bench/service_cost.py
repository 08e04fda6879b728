"""What the service costs without a model: `python -m tests.bench.service_cost`.

The real server with a null runner in one process, the load in another. Tells the server's processor time for a chunk of
20 frames at several numbers of chunks a message, by thread, and what a thousand playing sessions see of latency.
Prints a table; with --out writes service_cost.json and service_cost.md.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tests.bench.machine import ROOT, machine_facts
from tests.bench.null_load import Channels, Counts, Line, Paced, PacedResult, total

SIZES = (1, 10, 50, 200)
SESSIONS_IN_LOCKSTEP = 200
SETTINGS = (
    "--port", "0", "--ops-port", "0", "--log-level", "WARNING", "--drain-wait-s", "0", "--drain-grace-s", "0.5",
    "--max-sessions", "4000", "--max-sessions-per-stream", "4000", "--max-rows", "4000", "--denoise-steps", "2",
    "--events-per-second", "1000000", "--stream-events-per-second", "10000000",
)  # fmt: skip


@dataclass(frozen=True)
class NullServer:
    """A server process. threads: name -> the operating system's number."""

    pid: int
    address: str
    threads: dict[str, int]

    def cpu_s(self) -> dict[str, float]:
        """Processor seconds so far of the engine's thread, of the event loop's (the main one), and of all others."""
        names = {number: name for name, number in self.threads.items()}
        seconds = {"engine": 0.0, "event loop": 0.0, "others": 0.0}
        for task in Path(f"/proc/{self.pid}/task").iterdir():
            used_ns = int((task / "schedstat").read_text(encoding="ascii").split()[0])
            name = {"engine": "engine", "MainThread": "event loop"}.get(names.get(int(task.name), ""), "others")
            seconds[name] += used_ns / 1e9
        return seconds


@contextmanager
def null_server(*settings: str) -> Iterator[NullServer]:
    command = [sys.executable, "-m", "tests.bench.null_server", *SETTINGS, *settings]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        if not line:
            raise RuntimeError(f"the server did not start, exit code {process.wait()}")
        told = json.loads(line)
        yield NullServer(process.pid, f"127.0.0.1:{told['grpc_port']}", told["threads"])
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(30)
        process.stdout.close()


@dataclass(frozen=True)
class ChunkCost:
    """The median over repeats. cpu_us: processor microseconds a chunk, of the whole server and by thread."""

    sessions_a_stream: int
    chunks_a_message: float
    chunks_per_s: float
    cpu_us: dict[str, float]

    @property
    def total_us(self) -> float:
        return sum(self.cpu_us.values())

    @property
    def service_us(self) -> float:
        """Without the engine's thread."""
        return self.total_us - self.cpu_us["engine"]


async def chunk_cost(server: NullServer, sessions_a_stream: int, seconds: float, repeats: int) -> ChunkCost:
    """Sessions in lockstep, `sessions_a_stream` of them on each stream."""
    channels = Channels(server.address)
    lines = [Line(channels, sessions_a_stream) for _ in range(SESSIONS_IN_LOCKSTEP // sessions_a_stream)]
    await asyncio.gather(*(line.open() for line in lines))
    await asyncio.gather(*(line.advance_for(0.5) for line in lines))
    trials: list[tuple[Counts, float, dict[str, float]]] = []
    for _ in range(repeats):
        before, cpu_before, started_s = total(lines), server.cpu_s(), time.perf_counter()
        await asyncio.gather(*(line.advance_for(seconds) for line in lines))
        cpu_after, counts = server.cpu_s(), total(lines).minus(before)
        used = {name: 1e6 * (cpu_after[name] - cpu_before[name]) / counts.chunks for name in cpu_after}
        trials.append((counts, time.perf_counter() - started_s, used))
    for line in lines:
        line.cancel()
    await channels.close()
    return ChunkCost(
        sessions_a_stream,
        statistics.median(counts.chunks / counts.messages for counts, _, _ in trials),
        statistics.median(counts.chunks / elapsed_s for counts, elapsed_s, _ in trials),
        {name: statistics.median(used[name] for _, _, used in trials) for name in trials[0][2]},
    )


@dataclass(frozen=True)
class Latency:
    """At so many sessions in real time. (p50, p99, max) in ms; cpu_share: of one core, by thread."""

    sessions: int
    streams: int
    flush_ms: float
    edit_ms: tuple[float, float, float]
    ping_ms: tuple[float, float, float]
    generator_lag_ms: tuple[float, float, float]
    edits: int
    unanswered: int
    cpu_share: dict[str, float]

    @property
    def void(self) -> bool:
        """Whether the generator was too late itself for the figures to count."""
        return self.generator_lag_ms[1] > 5.0


async def latency(server: NullServer, sessions: int, streams: int, flush_ms: float, seconds: float) -> Latency:
    channels = Channels(server.address)
    lines = [Line(channels, sessions // streams) for _ in range(streams)]
    for first in range(0, streams, 50):
        await asyncio.gather(*(line.open() for line in lines[first : first + 50]))
    cpu_before, started_s = server.cpu_s(), time.perf_counter()
    result: PacedResult = await Paced(lines).run(warm_up_s=2.0, seconds=seconds)
    cpu_after, elapsed_s = server.cpu_s(), time.perf_counter() - started_s
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
        {name: (cpu_after[name] - cpu_before[name]) / elapsed_s for name in cpu_after},
    )


def milliseconds(seconds: list[float]) -> tuple[float, float, float]:
    """p50, p99 and the greatest. Raises RuntimeError when nothing was measured."""
    if not seconds:
        raise RuntimeError("nothing was measured: no answer came")
    p50, p99 = np.percentile(seconds, [50, 99]) * 1000
    return float(p50), float(p99), 1000 * max(seconds)


def markdown(facts: dict[str, str], costs: list[ChunkCost], latencies: list[Latency]) -> str:
    lines = [
        "| sessions a stream | chunks a message | chunks/s | CPU us a chunk | service alone "
        "| event loop | engine | gRPC, other |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|",
        *(
            f"| {each.sessions_a_stream} | {each.chunks_a_message:.1f} | {each.chunks_per_s:.0f} | {each.total_us:.1f} "
            f"| {each.service_us:.1f} | {each.cpu_us['event loop']:.1f} | {each.cpu_us['engine']:.1f} "
            f"| {each.cpu_us['others']:.1f} |"
            for each in costs
        ),
    ]  # fmt: skip
    if len(costs) > 1:
        ratio = costs[0].total_us / costs[-1].total_us
        lines += ["", f"One stream a character costs {ratio:.1f} times what one stream for all costs."]
    lines += [
        "",
        "| sessions | streams | flush | edit to frame p50 / p99 / max | ping p50 / p99 / max "
        "| generator lag p99 | server CPU |",
        "|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for each in latencies:
        edit, ping = (" / ".join(f"{value:.1f}" for value in values) for values in (each.edit_ms, each.ping_ms))
        void = " (void)" * each.void
        lines.append(
            f"| {each.sessions} | {each.streams} | {each.flush_ms:g} ms | {edit} ms | {ping} ms "
            f"| {each.generator_lag_ms[1]:.1f} ms{void} | {100 * sum(each.cpu_share.values()):.0f} % |"
        )
    lines += ["", *(f"- {name}: {value}" for name, value in facts.items()), ""]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.service_cost", description=__doc__)
    parser.add_argument("--out", type=Path, help="folder to write to (default: print only)")
    parser.add_argument("--quick", action="store_true", help="short trials")
    parser.add_argument(
        "--sizes", type=int, nargs="*", default=list(SIZES), help="chunks a message (default: %(default)s)"
    )
    parser.add_argument(
        "--sessions", type=int, nargs="*", default=[1, 1000], help="sessions playing (default: %(default)s)"
    )
    options = parser.parse_args()
    seconds, repeats, play_s = (1.0, 3, 5.0) if options.quick else (3.0, 3, 15.0)
    facts, costs, latencies = machine_facts(), [], []
    with null_server() as server:
        for size in sorted(options.sizes):
            costs.append(asyncio.run(chunk_cost(server, size, seconds, repeats)))
            print(f"{size} chunks a message: {costs[-1].total_us:.1f} us a chunk", flush=True)
    for flush_ms in (20.0, 5.0):
        for sessions in options.sessions:
            for streams in sorted({min(4, sessions), sessions}):
                with null_server("--flush-ms", str(flush_ms)) as server:
                    latencies.append(asyncio.run(latency(server, sessions, streams, flush_ms, play_s)))
                    print(f"{sessions} sessions on {streams} streams: {latencies[-1].edit_ms}", flush=True)
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
