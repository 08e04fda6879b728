"""The time that a load goes by."""

from __future__ import annotations

import asyncio
import time
from typing import Protocol


class LoadClock(Protocol):
    """Seconds that only grow, and a way to wait for some of them."""

    def now_s(self) -> float: ...

    async def sleep(self, seconds: float) -> None: ...


class RealTime:
    """time.monotonic, which other processes read too."""

    def now_s(self) -> float:
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
