"""The figures of the service with the built-in model: `python -m tests.bench --out out/bench`.

For each number of denoising steps, starts the real server and measures it as a client sees it, then measures
`motiongen_ardy.model.rollout` with one character at a time on the same machine. Client and server share the cores, as
on a developer's machine. Prints a table and writes service_figures.json and service_figures.md.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil
from rich.console import Console
from rich.status import Status

from motiongen_client import MotionClient
from motiongen_tools.server_process import ServerProcess
from tests.bench.machine import ROOT, machine_facts
from tests.bench.processes import MIB, memory_mib
from tests.bench.served import (
    QUICK,
    Effort,
    Latencies,
    Most,
    edit_latencies_ms,
    most_served,
    open_latencies_ms,
    windows_per_s,
)

CROWDS = (1, 8, 32)


@dataclass(frozen=True)
class Figures:
    """All figures for one number of denoising steps. Memory in MiB: the client's resident memory, the Pss of all of the
    server's processes.

    windows_per_s: by number of characters, which take frames as fast as they come. served_characters: what
    `motiongen bench --find` finds. rollout_windows_per_s: of `model.rollout`.
    """

    steps: int
    start_to_ready_s: float
    open_to_first_frame: Latencies
    edit_to_frame_alone: Latencies
    edit_to_frame_among_8: Latencies
    windows_per_s: dict[int, float]
    served_characters: Most
    server_memory_mib: float
    client_memory_mib: float
    rollout_windows_per_s: float

    @property
    def speed_up(self) -> float:
        """Windows per second of the largest crowd, divided by those of the plain rollout."""
        return self.windows_per_s[max(self.windows_per_s)] / self.rollout_windows_per_s


async def measure(steps: int, effort: Effort, status: Status) -> Figures:
    """Measure all figures for one number of denoising steps."""

    def say(what: str) -> None:
        status.update(f"{steps} steps: {what}")

    say("starting the server")
    with ServerProcess(["--denoise-steps", str(steps), "--playback-rate", "1000"]) as server:
        say("opening")
        opens = await open_latencies_ms(server.address, steps, effort.opens_s)
        say("edits of one character")
        alone = await edit_latencies_ms(server.address, steps, 1, effort.edits_s)
        say("edits among eight characters")
        among = await edit_latencies_ms(server.address, steps, 8, effort.edits_s)
        rates = {}
        async with MotionClient(server.address) as client:
            for characters in CROWDS:
                say(f"windows of {characters} characters")
                rates[characters] = await windows_per_s(client, steps, characters, effort.window_s)
        client_memory = psutil.Process().memory_info().rss / MIB
        most = await most_served(server.address, steps, effort, say)
        server_memory = sum(memory_mib(psutil.Process(server.pid)))
        ready_s = server.ready_s
    say("one rollout at a time")
    return Figures(
        steps=steps,
        start_to_ready_s=ready_s,
        open_to_first_frame=opens,
        edit_to_frame_alone=alone,
        edit_to_frame_among_8=among,
        windows_per_s=rates,
        served_characters=most,
        server_memory_mib=server_memory,
        client_memory_mib=client_memory,
        rollout_windows_per_s=rollout_rate(steps, effort.window_s),
    )


def rollout_rate(steps: int, seconds: float) -> float:
    """Windows per second of the plain rollout, measured in a separate process."""
    command = [sys.executable, "-m", "tests.bench.rollout_baseline", "--steps", str(steps), "--seconds", str(seconds)]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    rate: float = json.loads(done.stdout)["windows_per_s"]
    return rate


def markdown(facts: dict[str, str], figures: list[Figures]) -> str:
    """The figures as a table with a column for each number of steps, and facts about the machine."""

    def pair(each: Latencies) -> str:
        return f"{each.p50:.0f} / {each.p95:.0f} ms{' (void)' * each.is_void}"

    rows: list[tuple[str, list[str]]] = [
        ("start to ready", [f"{each.start_to_ready_s:.1f} s" for each in figures]),
        ("open to first frame, p50 / p95", [pair(each.open_to_first_frame) for each in figures]),
        ("event to first changed frame, alone, p50 / p95", [pair(each.edit_to_frame_alone) for each in figures]),
        ("the same among 8 characters", [pair(each.edit_to_frame_among_8) for each in figures]),
        *(
            (
                f"windows a second, {crowd} character{'s' * (crowd > 1)}",
                [f"{each.windows_per_s[crowd]:.1f}" for each in figures],
            )
            for crowd in CROWDS
        ),
        ("windows a second, plain rollout", [f"{each.rollout_windows_per_s:.1f}" for each in figures]),
        (f"{max(CROWDS)} characters against the plain rollout", [f"{each.speed_up:.1f} x" for each in figures]),
        ("characters of the scenario crowd served in full", [str(each.served_characters) for each in figures]),
        ("memory of the server", [f"{each.server_memory_mib:.0f} MiB" for each in figures]),
        ("memory of the client, 32 characters", [f"{each.client_memory_mib:.0f} MiB" for each in figures]),
    ]
    lines = ["| measured | " + " | ".join(f"{each.steps} steps" for each in figures) + " |"]
    lines.append("|---|" + "---|" * len(figures))
    lines += [f"| {name} | " + " | ".join(values) + " |" for name, values in rows]
    lines += ["", *(f"- {name}: {value}" for name, value in facts.items()), ""]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder to write to (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="short trials, for a rough result")
    parser.add_argument("--steps", type=int, nargs="+", default=[4, 10], help="denoising steps (default: 4 10)")
    options = parser.parse_args()
    console, facts, figures = Console(), machine_facts(), []
    for name, value in facts.items():
        console.print(f"{name}: {value}", highlight=False, soft_wrap=True)
    with console.status("") as status:
        for steps in options.steps:
            figures.append(asyncio.run(measure(steps, QUICK if options.quick else Effort(), status)))
            console.print(f"{steps} steps: measured")
    table = markdown(facts, figures)
    options.out.mkdir(parents=True, exist_ok=True)
    report = {"facts": facts, "quick": options.quick, "figures": [asdict(each) for each in figures]}
    (options.out / "service_figures.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    (options.out / "service_figures.md").write_text(table, encoding="utf-8")
    console.print(table, highlight=False, soft_wrap=True, markup=False)
    return 0
