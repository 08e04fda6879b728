"""The server under attack: a real process of the real server, with engines that compute nothing or a model."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from motiongen_server.devices import MOST_BY_DEFAULT, usable_cores
from tests.bench.processes import below, engines_of
from tests.conftest import ROOT
from tests.server_process import over, ready

NULL = ("tests.bench.null_server",)
SLOW_ENCODER = ("tests.attack.slow_encoder_server",)
BUILT_IN = ("motiongen_server", "--print-ports")
ORDINARY = (
    "--port", "0", "--ops-port", "0", "--drain-wait-s", "0", "--drain-grace-s", "0.5",
    "--devices", "cpu:1",
)  # fmt: skip
EVERY_CORE = ("--devices", f"cpu:{min(usable_cores(), MOST_BY_DEFAULT)}")
"""As a server has it by default, in place of the one engine that is ordinary here."""
QUIET = {"GRPC_VERBOSITY": "NONE"}
"""As the server has it: gRPC reads it when it is imported, which servers of tests do before they could set it."""
MIB = 1 << 20


@dataclass
class Attacked:
    """The server's process."""

    process: psutil.Process
    address: str
    ops_port: int
    log: Path
    exit_code: int | None = None

    def memory_mib(self) -> float:
        """Resident memory now, of the gateway and of all processes below it."""
        return sum(each.memory_info().rss for each in (self.process, *below(self.process))) / MIB

    def engines(self) -> list[psutil.Process]:
        """Its engine processes."""
        return engines_of(self.process)

    def log_mib(self) -> float:
        """Size of what it has logged."""
        return self.log.stat().st_size / MIB

    def cpu_s(self) -> float:
        """Processor time so far, of the gateway."""
        times = self.process.cpu_times()
        return float(times.user + times.system)


@contextmanager
def attacked(
    log: Path,
    settings: tuple[str, ...] = (),
    most_files: int | None = None,
    module: tuple[str, ...] = NULL,
    environment: Mapping[str, str] | None = None,
) -> Iterator[Attacked]:
    """Start a server; SIGTERM ends it, and what it exits with is noted. most_files: its limit of open descriptors.

    settings: in place of what is ordinary, devices too. environment: what it finds besides this process's.
    """

    # By the shell, not between fork and exec: gRPC's threads in this process make Python code there unsafe.
    limited = () if most_files is None else ("/bin/sh", "-c", f'ulimit -n {most_files} && exec "$@"', "sh")
    python_path = os.environ.get("ATTACKED_PYTHONPATH", os.environ.get("PYTHONPATH", ""))
    with log.open("w", encoding="utf-8") as errors:
        process = subprocess.Popen(
            [*limited, sys.executable, "-m", *module, *over(ORDINARY, settings)],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True,
            env={**os.environ, **QUIET, "PYTHONPATH": python_path, **(environment or {})},
        )  # fmt: skip
    with ready(process, log) as told:
        server = Attacked(psutil.Process(process.pid), f"127.0.0.1:{told['grpc_port']}", told["ops_port"], log)
        yield server
    server.exit_code = process.returncode
