"""What a server that the command started uses while it is measured: processor time, memory, and wasted steps."""

from __future__ import annotations

import asyncio
import contextlib
import time
import urllib.request
from dataclasses import dataclass
from http.client import HTTPException
from typing import TYPE_CHECKING

from motiongen_client.errors import MissingExtra
from motiongen_tools.bench.schedule import Phases

if TYPE_CHECKING:
    from psutil import Process

_SAMPLE_PERIOD_S = 0.5
_METRICS_TIMEOUT_S = 5.0
_STEPS, _DISCARDED = "motiongen_batch_rows_sum", "motiongen_steps_discarded_total"


@dataclass(frozen=True)
class ServerUse:
    """Use of a server and its child processes, while measuring. cores: processor seconds a second; memory is resident.

    thrown_away: the share of denoising steps whose windows were discarded; None if it is not known.
    """

    cores: float
    peak_mib: float
    thrown_away: float | None = None


@dataclass(frozen=True)
class _Use:
    """What one process has used: processor seconds since it started, and resident bytes."""

    cpu_s: float
    resident: int


class ServerWatch:
    """Watches a process from outside. Raises MissingExtra without psutil.

    ops_address: host:port of the server's metrics; "" if they are not to be read.
    """

    def __init__(self, pid: int, ops_address: str = "") -> None:
        self._ops_address = ops_address
        try:
            import psutil
        except ImportError:
            raise MissingExtra("watching a server", "psutil", "bench") from None
        self._process = psutil.Process(pid)
        self._gone, self._ended = psutil.NoSuchProcess, psutil.STATUS_ZOMBIE

    async def follow(self, start_at_s: float, phases: Phases) -> ServerUse | None:
        """Wait until the measurement is over. start_at_s: on time.monotonic. Returns None if the server ended.

        A child process that ends meanwhile, such as an engine that is lost, counts up to the last look at it.
        """
        await asyncio.sleep(max(start_at_s + phases.measure_from_s - time.monotonic(), 0))
        steps = await self._steps()
        from_s, before = time.monotonic(), self._look()
        latest, peak = dict(before), 0
        while time.monotonic() < start_at_s + phases.measure_to_s:
            now = self._look()
            latest |= now
            peak = max(peak, sum(use.resident for use in now.values()))
            await asyncio.sleep(_SAMPLE_PERIOD_S)
        latest |= self._look()
        took_s = time.monotonic() - from_s
        if not self._is_there():
            return None
        used_s = sum(use.cpu_s for use in latest.values()) - sum(use.cpu_s for use in before.values())
        return ServerUse(used_s / took_s, peak / 2**20, thrown_away(steps, await self._steps()))

    async def _steps(self) -> tuple[float, float] | None:
        """Rows of denoising steps so far, and how many of them were discarded."""
        if not self._ops_address:
            return None
        try:
            text = await asyncio.to_thread(_read, f"http://{self._ops_address}/metrics")
        except (OSError, HTTPException):  # it may end in the middle of its answer
            return None
        return total(text, _STEPS), total(text, _DISCARDED)

    def _look(self) -> dict[Process, _Use]:
        """What the server and its child processes have used so far; without those that end meanwhile."""
        found = {}
        with contextlib.suppress(self._gone):
            for process in [self._process, *self._process.children(recursive=True)]:
                with contextlib.suppress(self._gone):
                    times = process.cpu_times()
                    found[process] = _Use(times.user + times.system, process.memory_info().rss)
        return found

    def _is_there(self) -> bool:
        """Whether the server runs. A process that ended and was not waited for still has a number, but uses nothing."""
        try:
            return self._process.is_running() and self._process.status() != self._ended
        except self._gone:
            return False


def total(metrics: str, name: str) -> float:
    """The sum of a metric over its labels, from the text of /metrics; 0 if there is none of the name."""
    found = (line.rsplit(" ", 1) for line in metrics.splitlines() if line.startswith((f"{name} ", f"{name}{{")))
    return sum(float(value) for _, value in found)


def thrown_away(before: tuple[float, float] | None, after: tuple[float, float] | None) -> float | None:
    """The share of discarded steps between two readings."""
    if before is None or after is None or after[0] <= before[0]:
        return None
    return (after[1] - before[1]) / (after[0] - before[0])


def _read(url: str) -> str:
    with urllib.request.urlopen(url, timeout=_METRICS_TIMEOUT_S) as answer:
        text: str = answer.read().decode()
    return text
