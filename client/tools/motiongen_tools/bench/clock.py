"""The clock of a load."""

from __future__ import annotations

import asyncio
import time
from typing import Protocol


class LoadClock(Protocol):
    """Seconds that never decrease, and a way to wait."""

    def now_s(self) -> float: ...

    async def sleep(self, seconds: float) -> None: ...


class RealTime:
    """time.monotonic, which is the same in all processes."""

    def now_s(self) -> float:
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
