"""Two clocks for one thread: the one on the wall, and one that only runs while this process has a core."""

from __future__ import annotations

import time
from typing import Protocol


class BenchClock(Protocol):
    """Satisfies `motiongen_server.engine.ports.Clock`, and can be slept by."""

    def now(self) -> float: ...

    def sleep(self, seconds: float) -> None: ...


class WallClock:
    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class ProcessorClock:
    """Counts the processor time of this process, and what it slept, which takes no time at all.

    What is measured by it is what one core of one's own would give, whoever else uses the machine. It is wrong where
    a process computes on several threads at once.
    """

    def __init__(self) -> None:
        self._slept_s = 0.0

    def now(self) -> float:
        return time.process_time() + self._slept_s

    def sleep(self, seconds: float) -> None:
        self._slept_s += seconds
