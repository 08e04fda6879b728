"""A server without a model, in its own process, and the CPU time that its threads have used."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from tests.bench.machine import ROOT
from tests.bench.processes import below, processor_s
from tests.bench.revision import Revision
from tests.server_process import ready

NULL_SERVER = "tests.bench.null_server"
SETTINGS = (
    "--port", "0", "--ops-port", "0", "--log-level", "WARNING", "--drain-wait-s", "0", "--drain-grace-s", "0.5",
    "--max-sessions", "4000", "--max-sessions-per-stream", "4000", "--max-rows", "4000", "--denoise-steps", "2",
    "--peer-events-per-second", "1000000000", "--peer-calls-per-second", "1000000", "--peer-session-weight", "1000000",
    "--devices", "cpu:1", "--events-per-second", "1000000", "--stream-events-per-second", "10000000",
)  # fmt: skip
NO_LOOP_SHARE = ("--loop-share", "1000000000")
"""For revisions that have this setting: measurements are of how much the service can do, without that limit."""


@dataclass(frozen=True)
class NullServer:
    """A server's process. threads: name -> the operating system's thread number."""

    pid: int
    address: str
    threads: dict[str, int]

    def cpu_s(self) -> dict[str, float]:
        """CPU seconds used so far by the engines (processes, or a thread), the event loop, and all other threads."""
        names = {number: name for name, number in self.threads.items()}
        seconds = {"engine": 0.0, "event loop": 0.0, "others": 0.0}
        for task in Path(f"/proc/{self.pid}/task").iterdir():
            used_ns = int((task / "schedstat").read_text(encoding="ascii").split()[0])
            name = {"engine": "engine", "MainThread": "event loop"}.get(names.get(int(task.name), ""), "others")
            seconds[name] += used_ns / 1e9
        seconds["engine"] += processor_s(below(psutil.Process(self.pid)))
        return seconds


@contextmanager
def server_process(module: str, *arguments: str, revision: Revision | None = None) -> Iterator[NullServer]:
    """Start a server. revision: the revision to run (default: this checkout, with this process's paths).

    It gets its own state folder: the contents of the user's folder, or of earlier runs, would be measured too.
    """
    tree, environment = (ROOT, dict(os.environ)) if revision is None else (revision.tree, revision.environment)
    is_known = "--port" in arguments and any((tree / "server/motiongen_server/rpc").rglob("loop_time.py"))
    unbounded = NO_LOOP_SHARE if is_known and NO_LOOP_SHARE[0] not in arguments else ()
    command = [sys.executable, "-m", module, *arguments, *unbounded]
    with tempfile.TemporaryDirectory(prefix="motiongen-null-") as state:
        environment["XDG_STATE_HOME"] = state
        process = subprocess.Popen(command, cwd=tree, env=environment, stdout=subprocess.PIPE, text=True)
        with ready(process) as told:
            yield NullServer(process.pid, f"127.0.0.1:{told['grpc_port']}", told["threads"])
