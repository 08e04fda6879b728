"""Holding: what one clip call holds in memory; ends the call if that is too much."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from motiongen_server.engine.types import Chunk, ConstraintReached, Output
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.errors.streams import failed_inside
from motiongen_server.rpc.send_queue import size_of

OBJECT_BYTES = 256
"""An output's memory in addition to its rows, or to its size on the wire."""


class Holding:
    """A call's request, and the engine's outputs that its client has not taken, in order.

    refusal: why the call is ended before it has finished. cut: ends it. Lives on the event loop, except
    num_waiting_bytes.
    """

    def __init__(self, request_bytes: int, note: Callable[[int], None] = lambda _: None, peer_name: str = "") -> None:
        """request_bytes: what the request takes as long as the call lasts. note: is told of bytes added and removed.

        peer_name: of the peer that the call counts for.
        """
        self.peer_name = peer_name
        self.refusal: StreamRefused | None = None
        self.cut: Callable[[], object] = lambda: None
        self._request_bytes = request_bytes
        self._said: asyncio.Queue[Output] = asyncio.Queue()
        self._said_bytes = 0
        self._note = note

    @property
    def num_waiting_bytes(self) -> int:
        """Bytes of the request, of outputs that are not written yet, and of those kept for the summaries."""
        return self._request_bytes + self._said_bytes

    def put(self, outputs: Sequence[Output]) -> None:
        """Queue outputs of the engine; for a call that is being ended they are dropped."""
        if self.refusal is not None:
            return
        num_bytes = 0
        for output in outputs:
            self._said.put_nowait(output)
            num_bytes += bytes_of(output)
        self._said_bytes += num_bytes
        self._note(num_bytes)

    async def next(self) -> Output:
        """Wait for the oldest output in the queue, and remove it."""
        return await self._said.get()

    def done(self, output: Output) -> None:
        """An output was written. A ConstraintReached continues to count: it is kept for the sample's summary."""
        if self.refusal is None and not isinstance(output, ConstraintReached):
            num_bytes = bytes_of(output)
            self._said_bytes -= num_bytes
            self._note(-num_bytes)

    def refuse(self, refusal: StreamRefused) -> None:
        """End the call, and drop what waits."""
        self.refusal = refusal
        self._said, self._said_bytes = asyncio.Queue(), 0
        self.cut()

    def fail(self, error: Exception) -> None:
        """End the call because of a fault of the server's own, which is logged."""
        self.refuse(failed_inside("a clip failed", "the clip failed inside the server", error))


def bytes_of(output: Output) -> int:
    """Roughly how many bytes an output takes in memory."""
    return OBJECT_BYTES + (output.rows.nbytes if isinstance(output, Chunk) else size_of(output))
