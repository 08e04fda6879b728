"""The server under attack: a real server process, with a model or with engines that compute nothing."""

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
"""As many engines as a server has by default, instead of the one in `ORDINARY`."""
QUIET = {"GRPC_VERBOSITY": "NONE"}
"""The server's own setting. Test servers import gRPC, which reads it then, before they could set it themselves."""
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
        """Resident memory now, of the gateway and all its child processes."""
        return sum(each.memory_info().rss for each in (self.process, *below(self.process))) / MIB

    def engines(self) -> list[psutil.Process]:
        """Its engine processes."""
        return engines_of(self.process)

    def log_mib(self) -> float:
        """The size of its log."""
        return self.log.stat().st_size / MIB

    def cpu_s(self) -> float:
        """The gateway's processor time so far."""
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
    """Start a server, and end it with SIGTERM; its exit code is recorded. most_files: its limit of open descriptors.

    settings: override those in `ORDINARY`. environment: additional variables.
    """

    # Set by a shell: Python code between fork and exec is unsafe beside gRPC's threads in this process.
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
