"""A server as a child process: started on free ports, stopped by SIGTERM. For demos, tests and measurements.

The server is another distribution; it is run, never imported.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from motiongen_client.errors import MotiongenError

_LOG_TAIL_LINES = 30
_LAST_LINE_BYTES = 4096
_LOOK_EVERY_S = 0.2


class ServerFailed(MotiongenError):
    """The server process did not start, or did not end as it should.

    log_tail: the last lines of its log. log: the file with the whole log, None if it was not kept.
    """

    def __init__(self, what: str, log_tail: str, log: Path | None = None) -> None:
        where = "" if log is None else f", all of which is in {log}"
        super().__init__(f"{what}\nlast lines of the server's log{where}:\n{log_tail or '(nothing was written)'}")
        self.log_tail = log_tail
        self.log = log


class ServerProcess:
    """`python -m motiongen_server` as a child process. `with ServerProcess() as server` waits until it is ready.

    arguments: further settings for the server, such as ["--denoise-steps", "10"]; `motiongen-server --help` lists them.
    ready_timeout_s: end the server if it is not ready by then; None: wait as long as it runs, because a first start may
    have to fetch gigabytes. tell: called by another thread with the last line of the log, whenever it changes. address:
    host:port of the service; ops_address: of health checks and metrics. ready_s: seconds from start to ready.
    """

    def __init__(
        self,
        arguments: Sequence[str] = (),
        *,
        ready_timeout_s: float | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self._command = [
            sys.executable, "-m", "motiongen_server",
            "--host", "127.0.0.1", "--port", "0", "--ops-port", "0", "--print-ports", *arguments,
        ]  # fmt: skip
        self._ready_timeout_s = ready_timeout_s
        self._tell = tell
        self._process: subprocess.Popen[str] | None = None
        self.address = ""
        self.ops_address = ""
        self.ready_s = 0.0

    def start(self) -> ServerProcess:
        """Start the server and wait until it is ready. Does nothing if it was started and not stopped since.

        Raises ServerFailed with the tail of its log.
        """
        if self._process is not None:
            return self
        started_s = time.monotonic()
        with tempfile.NamedTemporaryFile("w", prefix="motiongen-server-", suffix=".log", delete=False) as log:
            self._log_path = Path(log.name)
            self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            ports = self._read_ports(self._process)
        except BaseException as failure:  # Ctrl-C too: nobody else would end the process
            self._abandon()
            if not isinstance(failure, ServerFailed):
                self._log_path.unlink(missing_ok=True)  # no error names it
            raise
        self.address = f"127.0.0.1:{ports['grpc_port']}"
        self.ops_address = f"127.0.0.1:{ports['ops_port']}"
        self.ready_s = time.monotonic() - started_s
        return self

    def _abandon(self) -> None:
        """Kill a server that has not become ready."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()

    def stop(self, timeout_s: float = 30.0) -> None:
        """Send SIGTERM and wait for the server to end. Raises ServerFailed unless it exits with 0 in time."""
        process = self._process
        if process is None:
            return
        self._process = None
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        try:
            code = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise self._failed(f"the server did not end within {timeout_s:g} s of SIGTERM") from None
        finally:
            if process.stdout is not None:
                process.stdout.close()
        if code != 0:
            raise self._failed(f"the server ended with exit code {code}, not 0")
        self._log_path.unlink(missing_ok=True)

    @property
    def pid(self) -> int | None:
        """Process id while the server runs, otherwise None."""
        return None if self._process is None else self._process.pid

    def log_tail(self) -> str:
        """The last lines of the log, which is the server's standard error."""
        text = self._log_path.read_text(encoding="utf-8", errors="replace")
        return "\n".join(text.splitlines()[-_LOG_TAIL_LINES:])

    def _last_line(self) -> str:
        """The last line of the log that is not blank. For a progress bar, its current state."""
        with self._log_path.open("rb") as log:
            log.seek(max(0, self._log_path.stat().st_size - _LAST_LINE_BYTES))
            lines = log.read().decode("utf-8", errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def __enter__(self) -> ServerProcess:
        return self.start()

    def __exit__(self, failure: type[BaseException] | None, *_: object) -> None:
        try:
            self.stop()
        except ServerFailed:
            if failure is None:
                raise
            self._log_path.unlink(missing_ok=True)  # the first failure is the one to report

    def _read_ports(self, process: subprocess.Popen[str]) -> dict[str, int]:
        """The ports, which the server prints once ready. A thread passes log lines on and enforces the timeout."""
        assert process.stdout is not None
        over, late = threading.Event(), threading.Event()
        watching = threading.Thread(target=self._watch, args=(process, over, late), daemon=True)
        watching.start()
        try:
            line = process.stdout.readline()
        finally:
            over.set()
            watching.join()
        if line:
            ports: dict[str, int] = json.loads(line)
            return ports
        code = process.wait()
        if late.is_set():
            what = f"the server was not ready within {self._ready_timeout_s:g} s"
        elif "No module named motiongen_server" in self.log_tail():
            what = f"the server is not installed in {os.path.basename(sys.executable)}: install motiongen-server"
        else:
            what = f"the server did not start (exit code {code})"
        raise self._failed(what)

    def _failed(self, what: str) -> ServerFailed:
        return ServerFailed(what, self.log_tail(), self._log_path)

    def _watch(self, process: subprocess.Popen[str], over: threading.Event, late: threading.Event) -> None:
        """Until `over` is set: pass new last lines of the log on, and kill the process at its timeout."""
        most_s = math.inf if self._ready_timeout_s is None else self._ready_timeout_s
        end_s, told = time.monotonic() + most_s, ""
        while not over.wait(min(_LOOK_EVERY_S, most_s)):
            if time.monotonic() >= end_s:
                late.set()
                process.kill()
                return
            if self._tell is not None and (line := self._last_line()) != told:
                told = line
                self._tell(line)
