"""ReaderPatience: limits how much may wait for a client that does not read, and for how long."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from motiongen_server.rpc.limits import Limits


class ReaderPatience:
    """Gives up on a reader when too much waits for it at once, or a lot for too long."""

    def __init__(self, limits: Limits, give_up: Callable[[], None]) -> None:
        self._limits = limits
        self._give_up = give_up
        self._is_giving_up = False
        self._timer: asyncio.TimerHandle | None = None  # runs while the soft limit is exceeded

    def check(self, waiting_bytes: int) -> None:
        """Check how much waits now, in bytes beyond what a client is owed."""
        limits = self._limits
        if waiting_bytes > limits.hard_backlog_bytes:
            self._lose()
        elif waiting_bytes <= limits.soft_backlog_bytes:
            self.end()
        elif self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(limits.backlog_s, self._lose)

    def end(self) -> None:
        """Stop the timer: the limits are met, or no longer matter."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _lose(self) -> None:
        self.end()
        if self._is_giving_up:  # telling the sessions of it queues more, which is checked here again
            return
        self._is_giving_up = True
        try:
            self._give_up()
        finally:
            self._is_giving_up = False
