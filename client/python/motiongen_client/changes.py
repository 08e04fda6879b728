"""Changes: an event that counts, so that another thread can see whether anything has happened without asking."""

from __future__ import annotations

import asyncio


class Changes(asyncio.Event):
    """Set when something came, or is due now. count: how often; reading it needs no lock."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def set(self) -> None:
        self.count += 1
        super().set()
