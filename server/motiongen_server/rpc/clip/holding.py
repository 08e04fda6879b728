"""Holding: what one call for clips holds in memory, and what ends it where that is too much."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from motiongen_server.engine.types import Chunk, ConstraintReached, Output
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.errors.streams import failed_inside
from motiongen_server.rpc.send_queue import size_of

OBJECT_BYTES = 256
"""Of an output in memory besides its rows, or what it takes on the wire."""


class Holding:
    """The request of a call, and what the engine has said of it and its client has not taken, in order.

    refusal: why it is ended before it has finished. cut: ends it. Lives on the event loop, but for num_waiting_bytes.
    """

    def __init__(self, request_bytes: int, note: Callable[[int], None] = lambda _: None) -> None:
        """request_bytes: that the request takes, as long as the call lasts. note: is told of bytes that come and go."""
        self.refusal: StreamRefused | None = None
        self.cut: Callable[[], object] = lambda: None
        self._request_bytes = request_bytes
        self._said: asyncio.Queue[Output] = asyncio.Queue()
        self._said_bytes = 0
        self._note = note

    @property
    def num_waiting_bytes(self) -> int:
        """Of the request, of what was said and is not written, and of what the summaries will tell."""
        return self._request_bytes + self._said_bytes

    def put(self, outputs: Sequence[Output]) -> None:
        """The engine has said this. Nothing is kept of what comes to a call that is being ended."""
        if self.refusal is not None:
            return
        num_bytes = 0
        for output in outputs:
            self._said.put_nowait(output)
            num_bytes += bytes_of(output)
        self._said_bytes += num_bytes
        self._note(num_bytes)

    async def next(self) -> Output:
        """What the engine said first of what has not been looked at."""
        return await self._said.get()

    def done(self, output: Output) -> None:
        """It was written. What became of a constraint is held on: the sample's summary tells."""
        if self.refusal is None and not isinstance(output, ConstraintReached):
            num_bytes = bytes_of(output)
            self._said_bytes -= num_bytes
            self._note(-num_bytes)

    def refuse(self, refusal: StreamRefused) -> None:
        """End the call, and let go of what waits."""
        self.refusal = refusal
        self._said, self._said_bytes = asyncio.Queue(), 0
        self.cut()

    def fail(self, error: Exception) -> None:
        """End the call for a fault of the server's own, which is logged."""
        self.refuse(failed_inside("a clip failed", "the clip failed inside the server", error))


def bytes_of(output: Output) -> int:
    """About how many bytes an output takes in memory."""
    return OBJECT_BYTES + (output.rows.nbytes if isinstance(output, Chunk) else size_of(output))
