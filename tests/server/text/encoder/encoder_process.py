"""An encoder service as a process that can be killed, paused, stopped, and started again at the same address."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from tests.waiting import LIMIT_S

ROOT = Path(__file__).resolve().parents[4]


class EncoderProcess:
    """`with EncoderProcess(log, ...)` starts it, and ends it in whatever state it is. options: those of the command."""

    def __init__(self, log: Path, *options: str) -> None:
        self._log = log
        self._options = options
        self.port = 0
        self.ops_port = 0
        self.start()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def start(self, *options: str) -> None:
        """Start it at its earlier address, or on a free port the first time. options: additional ones."""
        # Tried twice: an outgoing connection of another process may hold its port for a moment.
        line = self._begun(options) or self._begun(options)
        if not line:
            raise RuntimeError(f"the encoder did not start:\n{self._log.read_text()}")
        told = json.loads(line)
        self.port, self.ops_port = told["grpc_port"], told["ops_port"]

    def _begun(self, options: Sequence[str]) -> str:
        """Start the process. Returns the line that it prints once it is ready, "" if it has ended instead."""
        ports = ["--port", str(self.port), "--ops-port", "0", "--print-ports", "--drain-grace-s", "1"]
        with self._log.open("a", encoding="utf-8") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "motiongen_server.text.encoder", *ports, *self._options, *options],
                cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True,
            )  # fmt: skip
        assert self._process.stdout is not None
        with self._process.stdout:
            line = self._process.stdout.readline()
        if not line:
            self._process.wait(LIMIT_S)
        return line

    def kill(self) -> None:
        """Kill it, as if its machine had failed."""
        self._process.kill()
        self._process.wait(LIMIT_S)

    def stop(self) -> int:
        """End it as an orchestrator does. Returns the exit code."""
        self._process.terminate()
        return self._process.wait(LIMIT_S)

    def halt(self) -> None:
        """Pause it: it answers nothing, while its connections stay open."""
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        """Continue it after `halt`."""
        self._process.send_signal(signal.SIGCONT)

    def __enter__(self) -> EncoderProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait(LIMIT_S)
