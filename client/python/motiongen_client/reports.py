"""Reports: when the playheads of a stream are reported: regularly, and at once if a caller waits for frames."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

_MIN_GAP_S = 0.025  # 40 per second; servers allow a session 50 events per second


class Reports:
    """Calls report every period_s seconds and soon after each call of `soon`, from `begin` to `close`."""

    def __init__(self, period_s: float, report: Callable[[], None]) -> None:
        self._period_s = period_s
        self._report = report
        self._wanted = asyncio.Event()
        self._reporting: asyncio.Task[None] | None = None

    def begin(self) -> None:
        self._reporting = asyncio.create_task(self._go_on(), name="motiongen-report")

    def soon(self) -> None:
        """Report without waiting for the next regular report."""
        self._wanted.set()

    def cancel(self) -> None:
        """Stop reporting, without waiting for the task to end."""
        if self._reporting is not None:
            self._reporting.cancel()

    async def close(self) -> None:
        """Stop reporting. May be called again."""
        if self._reporting is not None:
            self._reporting.cancel()
            await asyncio.gather(self._reporting, return_exceptions=True)

    async def _go_on(self) -> None:
        while True:
            try:
                async with asyncio.timeout(self._period_s):
                    await self._wanted.wait()
            except TimeoutError:
                pass  # the regular report
            self._wanted.clear()
            self._report()
            await asyncio.sleep(_MIN_GAP_S)
