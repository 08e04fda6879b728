"""Several servers with a common store: real processes, and a real Redis."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Mapping, Sequence
from pathlib import Path

import psutil

from tests.scale.proxies import Behind, free_port
from tests.system.real_redis import start_redis, url_in
from tests.waiting import until

SMALL = (
    "--devices",
    "cpu:1",
    "--profile-s",
    "1",
    "--log-level",
    "WARNING",
    "--drain-grace-s",
    "1",
    "--admit-load",
    "100",
)
"""Settings of a server that shares a small machine with others: it refuses no session for load."""


PORT_TAKEN = "cannot listen on"
"""The message of a server whose port is taken, perhaps only briefly: each outgoing connection takes a port, too."""
SERVER = "motiongen_server"
NULL_SERVER = "tests.bench.null_server"
"""The same server without a model: its frames have no meaning and cost no time."""


class Replica:
    """`python -m motiongen_server`; it keeps its ports when it is restarted."""

    def __init__(
        self, name: str, folder: Path, store: str, arguments: Sequence[str] = (), program: str = SERVER
    ) -> None:
        self.name = name
        self.behind = Behind(free_port(), free_port())
        self.address = f"127.0.0.1:{self.behind.port}"
        self._log = folder / f"{name}.log"
        self._command = [
            sys.executable, "-m", program, "--port", str(self.behind.port), "--ops-port",
            str(self.behind.ops_port), "--snapshot-store", store, "--advertise-address", self.address,
            *SMALL, *arguments,
        ]  # fmt: skip
        self.process: subprocess.Popen[bytes] | None = None
        self._may_begin_again = False
        self.environment: Mapping[str, str] = {}
        """Environment variables in addition to this process's own, from the next start on."""

    @property
    def is_running(self) -> bool:
        """Whether there is a process."""
        return self.process is not None and self.process.poll() is None

    @property
    def is_ready(self) -> bool:
        """Whether it serves. If its port was not free, it is started once more.

        Raises RuntimeError with its log if it has ended by itself.
        """
        if not self.is_running:
            if self._may_begin_again and PORT_TAKEN in self.last_words():
                self.begin()
                self._may_begin_again = False
                return False
            raise RuntimeError(f"{self.name} has ended: {self.last_words()}")
        ready = bool(self._asked("/readyz"))
        self._may_begin_again &= not ready
        return ready

    def begin(self) -> None:
        """Start it; `is_ready` says when it serves."""
        with self._log.open("ab") as log:
            environment = {**os.environ, **self.environment}
            self.process = subprocess.Popen(self._command, stdout=log, stderr=log, env=environment)
        self._may_begin_again = True

    def last_words(self) -> str:
        """The end of its log."""
        return self._log.read_text(encoding="utf-8", errors="replace")[-2000:]

    def metric(self, name: str) -> float:
        """The sum of a metric over its labels; 0 while the server does not answer."""
        lines = self._asked("/metrics").decode().splitlines()
        return sum(float(line.rpartition(" ")[2]) for line in lines if line.split("{")[0].split(" ")[0] == name)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the gateway, such as SIGKILL, SIGTERM to drain, or SIGSTOP."""
        assert self.process is not None
        self.process.send_signal(number)

    def kill(self) -> None:
        """End the gateway at once; its engine processes end with it."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def kill_engine(self) -> None:
        """End an engine process at once; the gateway restarts it."""
        self.engine().kill()

    def engine(self) -> psutil.Process:
        """Its engine process: of the processes below the gateway, the one with most memory."""
        assert self.process is not None
        below = psutil.Process(self.process.pid).children(recursive=True)
        return max(below, key=lambda each: int(each.memory_info().rss))

    def stop(self) -> None:
        """End it, whatever its state."""
        if self.is_running:
            assert self.process is not None
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.process.pid, signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    def _asked(self, path: str) -> bytes:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.behind.ops_port}{path}", timeout=2) as answer:
                return bytes(answer.read())
        except (TimeoutError, OSError):
            return b""


class Replicas:
    """Use as `with Replicas(folder, 2) as replicas`: a Redis, and servers that are ready."""

    def __init__(
        self,
        folder: Path,
        count: int,
        arguments: Sequence[str] = (),
        store: str | None = None,
        program: str = SERVER,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """store: used instead of a new Redis. environment: for the servers, in addition to this process's."""
        self._folder = folder
        self._has_redis = store is None
        self.redis: subprocess.Popen[bytes] | None = None
        self.store = store or url_in(folder)
        names = [f"server-{letter}" for letter in "abcdef"[:count]]
        self.all = [Replica(name, folder, self.store, arguments, program) for name in names]
        for replica in self.all:
            replica.environment = environment or {}

    @property
    def exit_codes(self) -> dict[str, int | None]:
        """Exit codes of the servers that have ended."""
        return {each.name: each.process.returncode for each in self.all if each.process is not None}

    @property
    def behind(self) -> list[Behind]:
        """The servers' addresses, for a proxy."""
        return [replica.behind for replica in self.all]

    def start_redis(self) -> None:
        """Start the Redis, empty."""
        self.redis = start_redis(self._folder)

    def kill_redis(self) -> None:
        """End the Redis at once, with all its contents."""
        assert self.redis is not None
        self.redis.kill()
        self.redis.wait()

    def __enter__(self) -> Replicas:
        if self._has_redis:
            self.start_redis()
        for replica in self.all:
            replica.begin()
        try:
            for replica in self.all:
                until(lambda replica=replica: replica.is_ready)  # type: ignore[misc]
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for replica in self.all:
            replica.stop()
        if self.redis is not None:
            self.redis.kill()
            self.redis.wait()
