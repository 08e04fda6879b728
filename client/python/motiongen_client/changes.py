"""Changes: an event with a counter, by which another thread can tell, without a lock, whether anything happened."""

from __future__ import annotations

import asyncio


class Changes(asyncio.Event):
    """Set when something has arrived or is due now. count: how often it was set; reading it needs no lock."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def set(self) -> None:
        self.count += 1
        super().set()
