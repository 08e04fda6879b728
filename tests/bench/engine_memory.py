"""A server's memory and start by number of engines: `python -m tests.bench.engine_memory [--before COMMIT]`.

All processes below the gateway count, including the one that others are forked from. There is a row for each number of
engines: the number of processes, their mean resident memory, their share of memory that several of them map (Pss, which
can be added up), the memory of one process alone, and the CPU time until the server is ready. Then an engine is killed,
for the CPU time until another one serves. All figures come from `/proc`, so other work on the machine does not matter.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import IO

import psutil

from tests.bench.machine import ROOT, machine_facts
from tests.bench.processes import MIB, below, engines_of, memory_of, processor_s
from tests.bench.revision import Revision, commit_tree
from tests.server_process import ready

SETTINGS = ("--port", "0", "--ops-port", "0", "--print-ports", "--drain-wait-s", "0", "--drain-grace-s", "0")
COLUMNS = ("engines", "revision", "processes", "resident, each", "parts, together", "parts, an engine", "own, together",
           "start, s", "again, s")  # fmt: skip


@dataclass(frozen=True)
class Server:
    """A server that is ready."""

    gateway: psutil.Process
    log: IO[str]

    def serves_again(self) -> None:
        """Wait until a lost engine is replaced. Raises RuntimeError if the server ends instead."""
        if not any(line.find(" again, process ") > 0 for line in self.log):
            raise RuntimeError("the server has ended")


@contextmanager
def serving(revision: Revision, model: str, precision: str, engines: int) -> Iterator[Server]:
    command = [sys.executable, "-m", "motiongen_server", *SETTINGS, "--model", model, "--precision", precision]
    process = subprocess.Popen(
        [*command, "--devices", f"cpu:{engines}"],
        cwd=revision.tree,
        env=revision.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    with ready(process):
        yield Server(psutil.Process(process.pid), process.stderr)


def row(revision: Revision, model: str, precision: str, engines: int) -> str:
    with serving(revision, model, precision, engines) as server:
        under = below(server.gateway)
        start_s = processor_s(under)
        found = [memory_of(process.pid) for process in under]
        lost = engines_of(server.gateway)[0]
        before_s = processor_s([process for process in under if process != lost])
        os.kill(lost.pid, signal.SIGKILL)
        server.serves_again()
        again_s = processor_s(below(server.gateway)) - before_s
    mean = sum(memory.resident for memory in found) / len(found)
    parts, own = sum(memory.proportional for memory in found), sum(memory.own for memory in found)
    cells = [f"{size / MIB:.0f}" for size in (mean, parts, parts / engines, own)]
    return f"| {engines} | {revision.name} | {len(found)} | {' | '.join(cells)} | {start_s:.1f} | {again_s:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.engine_memory", description=__doc__)
    parser.add_argument("--engines", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--before", metavar="COMMIT", help="also measure this commit")
    parser.add_argument("--model", default="motiongen-mini")
    parser.add_argument("--precision", default="float32")
    options = parser.parse_args()
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---:|" * len(COLUMNS))
    with ExitStack() as stack:
        revisions = [Revision("now", ROOT)]
        if options.before:
            revisions.insert(0, stack.enter_context(commit_tree(options.before)))
        for engines in options.engines:
            for revision in revisions:
                print(row(revision, options.model, options.precision, engines), flush=True)
    print()
    for name, value in machine_facts().items():
        print(f"- {name}: {value}")


if __name__ == "__main__":
    main()
