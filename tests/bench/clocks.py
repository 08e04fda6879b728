"""Two clocks for one thread: wall-clock time, and one that only runs while this process has a core."""

from __future__ import annotations

import time
from typing import Protocol


class BenchClock(Protocol):
    """Satisfies `motiongen_server.engine.ports.Clock`, and can sleep."""

    def now(self) -> float: ...

    def sleep(self, seconds: float) -> None: ...


class WallClock:
    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class ProcessorClock:
    """Counts this process's CPU time plus its sleeps, which return at once.

    Figures measured with it are those of one dedicated core, even if others use the machine. It is wrong for a process
    that computes on several threads at once.
    """

    def __init__(self) -> None:
        self._slept_s = 0.0

    def now(self) -> float:
        return time.process_time() + self._slept_s

    def sleep(self, seconds: float) -> None:
        self._slept_s += seconds
