"""Line: the connection that all rooms share, and the server's catalogue once the server has been reached."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from motiongen_client.client import MotionClient
from motiongen_client.errors import MotiongenError, NotAllowed, ServerUnavailable

RETRY_S = 1.0


class Line:
    """Connects in the background, for as long as it takes. make_client: a client for the server, not connected yet."""

    def __init__(self, make_client: Callable[[], MotionClient]) -> None:
        self._make_client = make_client
        self._client: MotionClient | None = None
        self._detail = ""  # shown by pages
        self._why = "the first attempt to connect is under way"
        self.address = ""

    @property
    def client(self) -> MotionClient:
        """The connected client. Raises ServerUnavailable while there is none."""
        if self._client is None:
            raise ServerUnavailable(self.address, self._why)
        return self._client

    @property
    def has_catalog(self) -> bool:
        """Whether the server has ever been reached."""
        return self._client is not None

    def shown(self, num_open: int) -> dict[str, Any]:
        """The connection as the page shows it. num_open: number of characters; without any, no stream can be lost."""
        if self._client is None:
            return {"state": "connecting", "address": self.address, "detail": self._detail}
        state = "connected" if self._client.is_connected or num_open == 0 else "lost"
        return {"state": state, "address": self.address, "detail": ""}

    async def run(self) -> None:
        """Connect; returns when connected. Raises NotAllowed if the server refuses the caller."""
        while self._client is None:
            client = self._make_client()
            self.address = client.address
            try:
                self._client = await client.connect()
            except NotAllowed:
                raise
            except MotiongenError as failure:
                self._detail = str(failure)
                self._why = failure.detail if isinstance(failure, ServerUnavailable) else self._detail
                await asyncio.sleep(RETRY_S)

    async def close(self) -> None:
        """Close all sessions and the connection."""
        if self._client is not None:
            await self._client.close()
