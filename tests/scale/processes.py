"""The text encoder that several servers share, as a process that can be killed and started again."""

from __future__ import annotations

import subprocess
import sys
import urllib.request
from pathlib import Path

from tests.scale.proxies import free_port
from tests.waiting import until


class Encoder:
    """`python -m motiongen_server.text.encoder` with the built-in encoder; it keeps its ports when it is restarted."""

    def __init__(self, folder: Path) -> None:
        """folder: for its log."""
        self.port, self._ops_port = free_port(), free_port()
        self._log = folder / "encoder.log"
        self._process: subprocess.Popen[bytes] | None = None

    def begin(self) -> None:
        """Start it; `is_ready` says when it serves."""
        command = ["-m", "motiongen_server.text.encoder", "--text-encoder", "static", "--log-level", "WARNING"]
        ports = ["--port", str(self.port), "--ops-port", str(self._ops_port)]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen([sys.executable, *command, *ports], stdout=log, stderr=log)

    def start(self) -> None:
        """Start it, and return once it serves."""
        self.begin()
        until(lambda: self.is_ready)

    @property
    def is_ready(self) -> bool:
        """Whether it serves. Raises RuntimeError with its log if it has ended by itself."""
        if self._process is not None and self._process.poll() is not None:
            raise RuntimeError(f"the encoder has ended: {self._log.read_text(errors='replace')[-2000:]}")
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self._ops_port}/readyz", timeout=2) as answer:
                return bool(answer.status == 200)
        except (TimeoutError, OSError):
            return False

    def kill(self) -> None:
        """End it at once, with SIGKILL."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def stop(self) -> None:
        """End it, whatever its state."""
        if self._process is not None:
            self.kill()
