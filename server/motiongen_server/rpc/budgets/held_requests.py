"""HeldRequests: messages of a peer's streams that were read, and stay in memory until their events are paid for.

Requests of the peer's other calls count as well, as long as their clients have not closed their side.

A stream in debt is not read further, but a stream that waits for its client is handed the next message, whatever the
peer's other streams owe. So a thousand streams could each have a message of a megabyte held, for minutes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, cast

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.errors.streams import too_much_unpaid


class Ended(Exception):
    """The stream of a message was ended: the rest of the message is dropped.

    Raised instead of the stream's refusal, which lives as long as the stream: its traceback would keep the message.
    """


class Holder(Protocol):
    """A stream, or the request of another call."""

    refusal: StreamRefused | None

    def owed_s(self, now: float) -> float:
        """Seconds until more of it may be read."""

    def refuse(self, refusal: StreamRefused) -> None:
        """End it."""


class HeldRequests:
    """The held messages of one peer, at most one per stream. num_bytes: of all. Lives on the event loop."""

    __slots__ = ("_bytes", "num_bytes")

    def __init__(self) -> None:
        self._bytes: dict[Holder, int] = {}
        self.num_bytes = 0

    def of(self, stream: object) -> int:
        """Bytes that are held of one stream."""
        return self._bytes.get(cast(Holder, stream), 0)

    @contextmanager
    def holding(self, holder: Holder, num_bytes: int, most: int, kind: str) -> Iterator[None]:
        """Count a stream's message as held for the time of the block. If the peer's messages then take more than `most`
        bytes, the streams that owe the most are ended; one that keeps to an equal share owes nothing, and is spared.

        kind: of the peer. Raises Ended if the stream itself was ended.
        """
        self._bytes[holder] = num_bytes
        self.num_bytes += num_bytes
        try:
            self.bound(most, kind)
            if holder.refusal is not None:
                raise Ended
            yield
        finally:
            self._release(holder)

    def bound(self, most: int, kind: str) -> None:
        """End the streams that owe the most until all messages take no more than `most` bytes. To be called again when
        a message is charged: messages that came at the same moment owe nothing until then."""
        while self.num_bytes > most and (debtor := self._debtor()) is not None:
            self._release(debtor)
            debtor.refuse(too_much_unpaid(most, kind))

    def _debtor(self) -> Holder | None:
        """The holder that owes the most, if any does. A single one may have a message as long as messages may be."""
        now = time.monotonic()
        debtor = max(self._bytes, key=lambda each: (each.owed_s(now), self._bytes[each]))
        return debtor if len(self._bytes) > 1 and debtor.owed_s(now) > 0 else None

    def _release(self, holder: Holder) -> None:
        self.num_bytes -= self._bytes.pop(holder, 0)
