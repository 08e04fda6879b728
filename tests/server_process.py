"""A server process for tests and measurements: the line that it prints once it is ready, and its end.

No process is left running: one that does not end after SIGTERM is killed, and so is one whose test has failed.
"""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

from tests.waiting import LIMIT_S

DEVICES = "--devices"


class DidNotEnd(Exception):
    """A server did not end after SIGTERM, and was killed."""


def over(ordinary: Sequence[str], given: Sequence[str]) -> list[str]:
    """A server's settings: the usual ones, overridden by given ones.

    For most settings the last one counts. Devices add up, so the usual ones are dropped if others are given.
    """
    kept = list(ordinary)
    while DEVICES in given and DEVICES in kept:
        at = kept.index(DEVICES)
        del kept[at : at + 2]
    return [*kept, *given]


def end(process: subprocess.Popen[Any], limit_s: float = LIMIT_S) -> None:
    """Send SIGTERM, unless it has ended. If it does not end within so many seconds, kill it and raise DidNotEnd."""
    process.send_signal(signal.SIGTERM)
    try:
        if process.stderr is None:
            process.wait(limit_s)
        else:  # nothing else reads it any more, and it must not fill up
            process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        raise DidNotEnd(f"the server did not end within {limit_s:g} s of SIGTERM and was killed") from None


@contextmanager
def ready(
    process: subprocess.Popen[str], log: Path | None = None, limit_s: float = LIMIT_S
) -> Iterator[dict[str, Any]]:
    """Yield the JSON that it prints once it is ready, and end it after the block; then it has a `returncode`.

    log: where its standard error goes, unless that is a pipe. Raises RuntimeError with that log if it does not start,
    DidNotEnd if it does not end within limit_s.
    """
    assert process.stdout is not None
    try:
        line = process.stdout.readline()  # returns when the server is ready, or when the process ends
        if not line:
            code = process.wait()
            said = "" if log is None else log.read_text(encoding="utf-8", errors="replace")
            said += "" if process.stderr is None else process.stderr.read()
            raise RuntimeError(f"the server did not start, exit code {code}:\n{said}")
        yield json.loads(line)
        end(process, limit_s)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()


@asynccontextmanager
async def watched(process: asyncio.subprocess.Process) -> AsyncIterator[dict[str, Any]]:
    """The same for a process started by an event loop whose end is what is tested: only the test asks it to end."""
    assert process.stdout is not None
    try:
        line = await process.stdout.readline()
        if not line:
            raise RuntimeError(f"the server did not start:\n{(await process.communicate())[1].decode()}")
        yield json.loads(line)
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()
