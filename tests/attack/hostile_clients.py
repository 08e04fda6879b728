"""Clients: hostile clients as processes, which have to reach the server and run until they are killed."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from tests.conftest import ROOT
from tests.waiting import LIMIT_S, until_true


class HostileClientEnded(Exception):
    """A hostile client ended before it was killed, so that no attack was measured."""


class Clients:
    """Use as `with Clients(kind, address, 2) as clients`. kind: of `tests.attack.hostile`; "": no clients.

    The server may end their calls and connections, which they start again. If a client itself ends, it is broken, and
    the end of the block raises HostileClientEnded.
    """

    def __init__(self, kind: str, address: str, count: int, environment: Mapping[str, str] = os.environ) -> None:
        self._kind = kind
        self._command = [sys.executable, "-m", "tests.attack.hostile", kind, address]
        self._environment = dict(environment)
        self._count = count if kind else 0
        self._folder = tempfile.TemporaryDirectory(prefix="hostile-clients-")
        self._said, self._errors = (Path(self._folder.name) / name for name in ("said", "errors"))
        self._processes: list[subprocess.Popen[bytes]] = []

    def _check(self) -> None:
        for process in self._processes:
            if process.poll() is not None:
                said = self._errors.read_text(encoding="utf-8", errors="replace")[-4000:]
                raise HostileClientEnded(f"a client of kind {self._kind!r} ended with {process.returncode}:\n{said}")

    def _have_begun(self) -> bool:
        self._check()
        return len(self._said.read_text(encoding="utf-8").splitlines()) == self._count

    async def begun(self) -> None:
        """Wait until each has reached the server; see `tests.attack.begun`. Raises HostileClientEnded, TimeoutError."""
        async with asyncio.timeout(LIMIT_S):
            await until_true(self._have_begun)

    def __enter__(self) -> Clients:
        with self._said.open("ab") as said, self._errors.open("ab") as errors:  # all clients append to these
            self._processes += [
                subprocess.Popen(
                    [*self._command, str(seed)], cwd=ROOT, env=self._environment, stdout=said, stderr=errors
                )
                for seed in range(1, 1 + self._count)
            ]
        return self

    def __exit__(self, failure: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        try:
            if failure is None:
                self._check()
        finally:
            for process in self._processes:
                process.kill()
                process.wait()
            self._folder.cleanup()
