"""Event loop time that clients' messages take in the gateway: measured, so that the limit holds on every machine.

Budgets for events and bytes count what is sent, not the work that it causes: an edit of 256 rotations is as much work
as a hundred small edits, and on a slow processor as two hundred. So the time spent on a stream's messages is charged to
it once they are processed, and must be paid before more of the stream is read. Frames are not charged: a client that
only plays has asked for nothing.

The loop's time is charged and not the processor's, because it is what streams share: a loop has one second of it per
second, and if other programs use the processor too, everything that the loop does takes longer alike. But no client is
to pay because its short message was interrupted for long, or the machine stood still: the charge is limited to a
multiple of the processor time.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Coroutine, Generator, Hashable
from functools import partial
from types import TracebackType
from typing import Any, Generic, NamedTuple, TypeVar

from motiongen_server.rpc.budgets.token_bucket import TokenBucket

UNLIMITED = 1e9
"""A share that is never used up."""
REFUSED_TIMES = 4.0
"""Time spent on a refused event counts this many times. Nobody needs that work, and gRPC takes several times as long to
carry the event and its answer, on threads that compete with the engines for cores.
"""
MOST_TIMES = 8.0
"""At most this multiple of the processor time is charged; a loop with a fifth of a core takes five times as long."""


class Clocks(NamedTuple):
    """The clocks that measure work, in seconds. elapsed_s: since any moment; processor_s: of the calling thread."""

    elapsed_s: Callable[[], float] = time.perf_counter
    processor_s: Callable[[], float] = time.thread_time


CLOCKS = Clocks()

T = TypeVar("T")


class LoopTime:
    """How much of one event loop's time clients' messages may take. Lives on that loop.

    The tokens of its bucket are seconds. While clients together take more than their share of the loop, peers have
    equal parts of it, and the streams of a peer equal parts of the peer's; a stream within its part is not held back.
    taken_s: so far. num_held: how often the next read of a stream waited because of the time it had taken.
    """

    def __init__(self, share: float = UNLIMITED, now: float = 0.0, clocks: Clocks = CLOCKS) -> None:
        """share: of the loop's time, in seconds per second."""
        self.bucket = TokenBucket(share, now)
        self._used_by: Counter[Hashable] = Counter()
        self.taken_s = 0.0
        self.num_held = 0
        self.clocks = clocks

    @property
    def num_peers(self) -> int:
        """The number of peers with open streams, or with calls whose requests are being processed."""
        return len(self._used_by)

    def serves(self, peer: Hashable) -> bool:
        """Whether the peer is counted in `num_peers`."""
        return peer in self._used_by

    def enter(self, peer: Hashable) -> None:
        """A stream or call of the peer begins."""
        self._used_by[peer] += 1

    def leave(self, peer: Hashable) -> None:
        """One of them is over."""
        self._used_by[peer] -= 1
        if not self._used_by[peer]:
            del self._used_by[peer]


class Work:
    """Measures the event loop's work for one stream or call: `with work:` encloses all of it that does not await.

    Blocks may be nested: the outermost one is measured. `end` and `begin` leave out a wait within a block. num_events,
    num_refused: events in the current block, counted by the code that takes them.
    """

    __slots__ = ("_began_s", "_charge", "_computed_s", "_depth", "_loop_time", "num_events", "num_refused")

    def __init__(self, loop_time: LoopTime, charge: Callable[[float], None]) -> None:
        """charge: is given the seconds that each block took."""
        self._loop_time = loop_time
        self._charge = charge
        self._depth = 0
        self.num_events = self.num_refused = 0
        self._began_s = self._computed_s = 0.0

    def begin(self) -> None:
        """Work for the stream begins."""
        if not self._depth:
            elapsed_s, processor_s = self._loop_time.clocks
            self._began_s, self._computed_s = elapsed_s(), processor_s()
        self._depth += 1

    def end(self) -> None:
        """The work is done, or is about to wait."""
        self._depth -= 1
        if not self._depth:
            elapsed_s, processor_s = self._loop_time.clocks
            taken_s = min(elapsed_s() - self._began_s, MOST_TIMES * (processor_s() - self._computed_s))
            self._loop_time.taken_s += taken_s
            if self.num_refused:
                taken_s *= 1 + (REFUSED_TIMES - 1) * self.num_refused / self.num_events
            self.num_events = self.num_refused = 0
            self._charge(taken_s)

    async def of(self, begin: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Await a coroutine and return its result: its steps on the loop are measured, its waits are not."""
        return await _Steps(self, begin())

    def __enter__(self) -> None:
        self.begin()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()


class _Steps(Generic[T]):
    """Drives a coroutine as `yield from` does (PEP 380), and measures each step between two waits as work."""

    def __init__(self, work: Work, coroutine: Coroutine[Any, Any, T]) -> None:
        self._work = work
        self._coroutine = coroutine

    def __await__(self) -> Generator[Any, Any, T]:
        step: Callable[[], Any] = partial(self._coroutine.send, None)
        while True:
            try:
                with self._work:
                    waits_for = step()
            except StopIteration as end:
                value: T = end.value
                return value
            try:
                step = partial(self._coroutine.send, (yield waits_for))
            except GeneratorExit:
                self._coroutine.close()
                raise
            except BaseException as error:  # above all a cancellation
                step = partial(self._coroutine.throw, error)
