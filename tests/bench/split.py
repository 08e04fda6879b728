"""What an engine in a process of its own costs and gains: `python -m tests.bench.split`.

Measured against the engine on a thread of the server's process, in turn and in one run. Without a model: processor time
a chunk of 20 frames, with 50 chunks a message. With the built-in model: characters in real time, as `motiongen bench`
sees them. Prints a table; with --out writes split.json and split.md.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import psutil

from tests.bench.machine import ROOT, machine_facts
from tests.bench.service_cost import NullServer, chunk_cost, null_server

MODES = {"embedded": (), "engine process": ("--engine-process", "--text-encoder", "hashed")}
CHUNKS_A_MESSAGE = 50
FPS = 20


@dataclass(frozen=True)
class WithEngineProcess(NullServer):
    """A server whose engine is a process of its own."""

    engine: int = 0

    def cpu_s(self) -> dict[str, float]:
        """As of any server; the engine is the other process, and the thread that links to it is among the others."""
        times = psutil.Process(self.engine).cpu_times()
        return {**super().cpu_s(), "engine": times.user + times.system}


@contextmanager
def server_of(mode: str) -> Iterator[NullServer]:
    with null_server(*MODES[mode]) as server:
        children = psutil.Process(server.pid).children()
        yield WithEngineProcess(server.pid, server.address, server.threads, children[0].pid) if children else server


@dataclass(frozen=True)
class NullCost:
    """Without a model. cpu_us: processor microseconds a chunk, by thread and in all; chunks_per_s: as many as came."""

    mode: str
    chunks_per_s: float
    cpu_us: dict[str, float]
    total_us: float


def null_cost(mode: str, seconds: float, repeats: int) -> NullCost:
    with server_of(mode) as server:
        cost = asyncio.run(chunk_cost(server, CHUNKS_A_MESSAGE, seconds, repeats))
    return NullCost(mode, cost.chunks_per_s, cost.cpu_us, cost.total_us)


@dataclass(frozen=True)
class Crowd:
    """With the built-in model, so many characters in real time. Latencies in ms; cores and MiB of all its processes.

    playing: how many were let in and played, on average.
    """

    mode: str
    characters: int
    playing: float
    missed: float
    edit_p50_ms: float
    edit_p99_ms: float
    cores: float
    mib: float
    is_void: bool


def crowd(mode: str, characters: int, seconds: int) -> Crowd:
    """One run of `motiongen bench` against a server of its own."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["--start-server", "--scenario", "crowd", "--characters", str(characters), "--seconds", str(seconds)]
        settings = ["--", *MODES[mode][:1]] if MODES[mode] else []
        command = [
            sys.executable,
            "-m",
            "motiongen_client",
            "bench",
            *options,
            "--seed",
            "1",
            "--out",
            folder,
            *settings,
        ]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if not (Path(folder) / "result.json").exists():
            raise RuntimeError(f"motiongen bench failed with {done.returncode}:\n{done.stderr}")
        result: dict[str, Any] = json.loads((Path(folder) / "result.json").read_text(encoding="utf-8"))["result"]
    edits = result["latencies_ms"]["event_to_first_frame"]["all"]
    use = result["server_use"]
    return Crowd(
        mode,
        characters,
        result["figures"]["all"]["due"] / (FPS * seconds),
        result["figures"]["all"]["miss_ratio"],
        edits["p50"],
        edits["p99"],
        use["cores"],
        use["peak_mib"],
        bool(result["void"]),
    )


def markdown(facts: dict[str, str], costs: list[NullCost], crowds: list[Crowd]) -> str:
    lines = ["| no model | chunks/s | CPU us a chunk | event loop | engine | other |", "|---|---:|---:|---:|---:|---:|"]
    lines += [
        f"| {each.mode} | {each.chunks_per_s:.0f} | {each.total_us:.1f} | {each.cpu_us['event loop']:.1f} "
        f"| {each.cpu_us['engine']:.1f} | {each.cpu_us['others']:.1f} |"
        for each in costs
    ]
    lines += [
        "",
        "| built-in model | characters | playing | frames missed | edit to frame p50 / p99 | cores | memory |",
    ]
    lines += ["|---|---:|---:|---:|---:|---:|---:|"]
    lines += [
        f"| {each.mode}{' (void)' * each.is_void} | {each.characters} | {each.playing:.0f} | {each.missed:.2%} "
        f"| {each.edit_p50_ms:.0f} / {each.edit_p99_ms:.0f} ms | {each.cores:.2f} | {each.mib:.0f} MiB |"
        for each in crowds
    ]
    return "\n".join([*lines, "", *(f"- {name}: {value}" for name, value in facts.items()), ""])


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.split", description=__doc__)
    parser.add_argument("--out", type=Path, help="folder to write to (default: print only)")
    parser.add_argument("--seconds", type=float, default=3.0, help="of a trial without a model (default: %(default)s)")
    parser.add_argument(
        "--characters",
        type=int,
        nargs="*",
        default=[40, 80],
        help="with the model; none: leave it out (default: 40 80)",
    )
    parser.add_argument("--play", type=int, default=15, help="seconds of a trial with it (default: %(default)s)")
    options = parser.parse_args()
    facts, costs, crowds = machine_facts(), [], []
    for mode in MODES if options.seconds else ():
        costs.append(null_cost(mode, options.seconds, repeats=3))
        print(f"no model, {mode}: {costs[-1].total_us:.1f} us a chunk", flush=True)
    for characters in options.characters:
        for mode in MODES:
            crowds.append(crowd(mode, characters, options.play))
            print(f"{characters} characters, {mode}: {crowds[-1].missed:.2%} missed", flush=True)
    table = markdown(facts, costs, crowds)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        report = {"facts": facts, "no model": [asdict(c) for c in costs], "crowds": [asdict(c) for c in crowds]}
        (options.out / "split.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        (options.out / "split.md").write_text(table, encoding="utf-8")
    print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
