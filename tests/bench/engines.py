"""What several engine processes gain: `python -m tests.bench.engines --devices cpu:1 cpu:2`.

Starts a server for each of the given devices, one after another, and measures it with the built-in model as clients see
it: characters served in full, windows per second of 8 characters, edits among 8 that play, and memory. Prints a table;
with --out also writes engines.json and engines.md.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

from motiongen_client import MotionClient
from motiongen_tools.server_process import ServerProcess
from tests.bench.machine import machine_facts
from tests.bench.processes import below, memory_mib, processor_s
from tests.bench.served import QUICK, Effort, Latencies, Most, edit_latencies_ms, most_served, windows_per_s

CHARACTERS = 8
STEPS = 4
SETTINGS = ("--admit-load", "1000", "--degrade", "false", "--playback-rate", "1000")


@dataclass(frozen=True)
class Server:
    """A server that is ready."""

    pid: int
    address: str

    def memory_mib(self) -> list[float]:
        """The memory of each process, shared memory counted in parts (Pss)."""
        return memory_mib(psutil.Process(self.pid))

    def cpu_s(self) -> float:
        """CPU seconds used so far by all its processes."""
        gateway = psutil.Process(self.pid)
        return processor_s([gateway, *below(gateway)])


@dataclass(frozen=True)
class Figures:
    """The figures of one server. characters: None if not searched for. memory_mib: Pss of each process, gateway first.

    cpu_ms_per_window: the server's CPU milliseconds per window, with 8 characters as fast as possible.
    """

    engines: str
    characters: Most | None
    windows_per_s: float
    cpu_ms_per_window: float
    edits: Latencies
    memory_mib: list[float]


async def measured(name: str, server: Server, effort: Effort, search: bool) -> Figures:
    edits = await edit_latencies_ms(server.address, STEPS, CHARACTERS, effort.edits_s)
    cpu_before = server.cpu_s()
    async with MotionClient(server.address) as client:
        rate = await windows_per_s(client, STEPS, CHARACTERS, effort.window_s)
    cpu_s = server.cpu_s() - cpu_before
    characters = await most_served(server.address, STEPS, effort, lambda what: None) if search else None
    # The windows of its first second do not count, although they cost CPU time like any other.
    windows = rate * (effort.window_s + 1.0)
    return Figures(name, characters, rate, 1000 * cpu_s / windows, edits, server.memory_mib())


def markdown(facts: dict[str, str], figures: list[Figures]) -> str:
    lines = ["| engines | characters | windows/s, 8 rows | CPU a window | edit p50 / p99 | memory, gateway first |"]
    lines.append("|---|---:|---:|---:|---:|---|")
    lines += [
        f"| {each.engines} | {each.characters or '-'} | {each.windows_per_s:.1f} | {each.cpu_ms_per_window:.1f} ms "
        f"| {each.edits.p50:.0f} / {each.edits.p99:.0f} ms{' (void)' * each.edits.is_void} | "
        + " + ".join(f"{memory:.0f}" for memory in each.memory_mib)
        + " MiB |"
        for each in figures
    ]
    return "\n".join([*lines, "", *(f"- {name}: {value}" for name, value in facts.items()), ""])


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.engines", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--devices", nargs="+", default=["cpu:1", "cpu:2"], help="(default: cpu:1 cpu:2)")
    parser.add_argument("--quick", action="store_true", help="short trials, and no search for characters")
    parser.add_argument("--out", type=Path, help="folder to write to (default: print only)")
    options = parser.parse_args()
    effort = QUICK if options.quick else Effort(edits_s=53)
    figures = []
    for devices in options.devices:
        with ServerProcess([*SETTINGS, "--devices", devices]) as process:
            server = Server(process.pid, process.address)
            figures.append(asyncio.run(measured(devices, server, effort, search=not options.quick)))
            print(f"{devices}: measured", flush=True)
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
