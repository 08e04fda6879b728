"""What a server process of one's own uses while it is measured: processor time and memory."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from motiongen_client.errors import MissingExtra
from motiongen_tools.bench.schedule import Phases

if TYPE_CHECKING:
    from psutil import Process

_SAMPLE_PERIOD_S = 0.5


@dataclass(frozen=True)
class ServerUse:
    """Of a server and its child processes, while measuring. cores: processor seconds a second; memory is resident."""

    cores: float
    peak_mib: float


class ServerWatch:
    """Reads a process from outside. Raises MissingExtra without psutil."""

    def __init__(self, pid: int) -> None:
        try:
            import psutil
        except ImportError:
            raise MissingExtra("watching a server", "psutil", "bench") from None
        self._process = psutil.Process(pid)
        self._gone = psutil.NoSuchProcess

    async def follow(self, start_at_s: float, phases: Phases) -> ServerUse | None:
        """Wait until measuring is over. start_at_s: on time.monotonic. None when the server ended."""
        try:
            await asyncio.sleep(max(start_at_s + phases.measure_from_s - time.monotonic(), 0))
            from_s, cpu_from_s = time.monotonic(), sum(map(_cpu_s, self._family()))
            peak = 0
            while time.monotonic() < start_at_s + phases.measure_to_s:
                peak = max(peak, sum(process.memory_info().rss for process in self._family()))
                await asyncio.sleep(_SAMPLE_PERIOD_S)
            used_s = sum(map(_cpu_s, self._family())) - cpu_from_s
            return ServerUse(used_s / (time.monotonic() - from_s), peak / 2**20)
        except self._gone:
            return None

    def _family(self) -> list[Process]:
        return [self._process, *self._process.children(recursive=True)]


def _cpu_s(process: Process) -> float:
    times = process.cpu_times()
    return times.user + times.system
