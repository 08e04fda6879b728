"""HeldRequests: the messages of a peer's streams that were read, and wait in memory until their events are paid for.

And the requests of its other calls that have come, while their clients have not ended their side.

A stream that owes is not read on, but one that waits for its client is handed what comes next, whatever the others of
its peer owe. So a thousand streams could each have a message of a megabyte held, for minutes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, cast

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.errors.streams import too_much_unpaid


class Ended(Exception):
    """The stream of a message is ended: nothing more of it is taken.

    Not the reason itself, which lives on with the stream: what it was raised through would keep the message with it.
    """


class Holder(Protocol):
    """A stream, or a request of another call."""

    refusal: StreamRefused | None

    def owed_s(self, now: float) -> float:
        """Seconds until it may be read on."""

    def refuse(self, refusal: StreamRefused) -> None:
        """End it."""


class HeldRequests:
    """Of one peer, by stream; none has more than one. num_bytes: of all. Lives on the event loop."""

    __slots__ = ("_bytes", "num_bytes")

    def __init__(self) -> None:
        self._bytes: dict[Holder, int] = {}
        self.num_bytes = 0

    def of(self, stream: object) -> int:
        """What is held of one stream."""
        return self._bytes.get(cast(Holder, stream), 0)

    @contextmanager
    def holding(self, holder: Holder, num_bytes: int, most: int, kind: str) -> Iterator[None]:
        """A message of a stream is in memory for the time of the block; where all take more than `most` then, those of
        the streams that owe most are ended: who keeps to an equal part owes nothing, and is left alone.

        kind: of the peer. Raises Ended where the stream itself is one of them.
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
        """End the streams that owe most, as far as all take more than `most`. Messages that came at one moment owe only
        once they are counted, so this is asked at their turns, too."""
        while self.num_bytes > most and (debtor := self._debtor()) is not None:
            self._release(debtor)
            debtor.refuse(too_much_unpaid(most, kind))

    def _debtor(self) -> Holder | None:
        """Who owes most, if anybody does; one alone may have a message as long as messages may be."""
        now = time.monotonic()
        debtor = max(self._bytes, key=lambda each: (each.owed_s(now), self._bytes[each]))
        return debtor if len(self._bytes) > 1 and debtor.owed_s(now) > 0 else None

    def _release(self, holder: Holder) -> None:
        self.num_bytes -= self._bytes.pop(holder, 0)
