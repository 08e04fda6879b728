"""What several engine processes gain: `python -m tests.bench.engines --devices cpu:1 cpu:2`.

A server for each, one after the other and in one run, measured as a client sees it with the built-in model: characters
in real time, windows a second of 8 characters, edits among 8 that play, and memory. `--baseline FOLDER` adds a checkout
from before engine processes (package `server`), with its engine on a thread of its server. Prints a table; with --out
writes engines.json and engines.md.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import psutil

from motiongen_client import MotionClient
from tests.bench.machine import ROOT, machine_facts
from tests.bench.measure import QUICK, Effort, edit_latencies, realtime_characters, windows_per_s

CHARACTERS = 8
STEPS = 4
MIB = 1 << 20
SETTINGS = (
    "--port", "0", "--ops-port", "0", "--print-ports", "--log-level", "WARNING", "--drain-wait-s", "0",
    "--drain-grace-s", "0", "--admit-load", "1000", "--degrade", "false",
)  # fmt: skip


@dataclass(frozen=True)
class Server:
    """A server that is ready."""

    pid: int
    address: str

    def processes(self) -> list[psutil.Process]:
        """The gateway and its engine processes."""
        gateway = psutil.Process(self.pid)
        return [gateway, *gateway.children()]

    def memory_mib(self) -> list[float]:
        """Resident memory of each of its processes."""
        return [process.memory_info().rss / MIB for process in self.processes()]

    def cpu_s(self) -> float:
        """Processor seconds so far, of all its processes."""
        times = [process.cpu_times() for process in self.processes()]
        return sum(each.user + each.system for each in times)


@contextmanager
def serving(arguments: list[str], checkout: Path | None = None) -> Iterator[Server]:
    """A server of this tree, or of a checkout from before engine processes."""
    environment, module = dict(os.environ), "motiongen_server"
    if checkout is not None:
        environment["PYTHONPATH"] = os.pathsep.join([str(checkout), str(checkout / "proto" / "python")])
        module = "server"
    process = subprocess.Popen(
        [sys.executable, "-m", module, *SETTINGS, *arguments],
        cwd=checkout or ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        if not line:
            raise RuntimeError(f"the server did not start, exit code {process.wait()}")
        yield Server(process.pid, f"127.0.0.1:{json.loads(line)['grpc_port']}")
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(30)
        process.stdout.close()


@dataclass(frozen=True)
class Figures:
    """Of one server. Latencies in ms; memory in MiB, of each process, the gateway first.

    cpu_ms_per_window: processor milliseconds of the server for a window, 8 characters as fast as they come.
    """

    engines: str
    characters: int
    windows_per_s: float
    cpu_ms_per_window: float
    edit_p50_ms: float
    edit_p99_ms: float
    memory_mib: list[float]


async def measured(name: str, server: Server, effort: Effort) -> Figures:
    async with MotionClient(server.address) as client:
        edits = await edit_latencies(client, STEPS, effort.edits, CHARACTERS)
        cpu_before = server.cpu_s()
        rate = await windows_per_s(client, STEPS, CHARACTERS, effort.window_s)
        cpu_s = server.cpu_s() - cpu_before
        characters, _ = await realtime_characters(client, STEPS, effort, lambda what: None) if effort.most else (0, [])
    p50, p99 = np.percentile(edits, [50, 99]) * 1000
    # The first second of it is not counted as windows, but costs as much as any other.
    windows = rate * (effort.window_s + 1.0)
    return Figures(name, characters, rate, 1000 * cpu_s / windows, float(p50), float(p99), server.memory_mib())


def markdown(facts: dict[str, str], figures: list[Figures]) -> str:
    lines = ["| engines | characters | windows/s, 8 rows | CPU a window | edit p50 / p99 | memory, gateway first |"]
    lines.append("|---|---:|---:|---:|---:|---|")
    lines += [
        f"| {each.engines} | {each.characters or '-'} | {each.windows_per_s:.1f} | {each.cpu_ms_per_window:.1f} ms "
        f"| {each.edit_p50_ms:.0f} / {each.edit_p99_ms:.0f} ms | "
        + " + ".join(f"{memory:.0f}" for memory in each.memory_mib)
        + " MiB |"
        for each in figures
    ]
    return "\n".join([*lines, "", *(f"- {name}: {value}" for name, value in facts.items()), ""])


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.engines", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--devices", nargs="+", default=["cpu:1", "cpu:2"], help="(default: cpu:1 cpu:2)")
    parser.add_argument("--baseline", type=Path, help="a checkout from before engine processes")
    parser.add_argument("--baseline-threads", type=int, nargs="+", default=[1, 2], help="its threads (default: 1 2)")
    parser.add_argument("--quick", action="store_true", help="short trials, and no search for characters")
    parser.add_argument("--out", type=Path, help="folder to write to (default: print only)")
    options = parser.parse_args()
    effort = Effort(edits=QUICK.edits, window_s=QUICK.window_s, most=0) if options.quick else Effort(edits=100)
    runs: list[tuple[str, list[str], Path | None]] = [
        (f"in the server, {threads} threads", ["--threads", str(threads)], options.baseline)
        for threads in (options.baseline_threads if options.baseline else ())
    ]
    runs += [(devices, ["--devices", devices], None) for devices in options.devices]
    figures = []
    for name, arguments, checkout in runs:
        with serving(arguments, checkout) as server:
            figures.append(asyncio.run(measured(name, server, effort)))
            print(f"{name}: measured", flush=True)
    facts = machine_facts()
    table = markdown(facts, figures)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        report = {"facts": facts, "quick": options.quick, "figures": [asdict(each) for each in figures]}
        (options.out / "engines.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        (options.out / "engines.md").write_text(table, encoding="utf-8")
    print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
