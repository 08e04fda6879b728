"""What clients' messages take of the gateway's event loop: measured, so that it holds on every machine.

Budgets of events and bytes count what is sent, and know nothing of what that takes: an edit of 256 rotations is the
work of a hundred small ones, and on a slow processor of two hundred. So the time of all that is done for a stream's
messages is charged to it once it is done, and paid before more of the stream is read. Frames are not charged: who plays
on has asked for nothing.

It is the loop's time, not the processor's: that is what streams share, one loop has a second of it in each second, and
where others use the processor too, all that the loop does takes longer alike. But a short message that happens to be
interrupted for long, or a machine that stands still, is not to be paid for by who was being served: no more is charged
than some times the processor time.
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
"""A share that nothing comes near."""
REFUSED_TIMES = 4.0
"""What the loop does for an event that is refused counts so often. Nobody needs it, and what gRPC does to carry it and
its answer, on threads that want the cores of the engines, takes several times as long.
"""
MOST_TIMES = 8.0
"""The processor time of a stretch of work, that is charged for it; a loop that gets a fifth of a core takes five."""


class Clocks(NamedTuple):
    """By which work is measured, both in seconds. elapsed_s: since any moment; processor_s: of the calling thread."""

    elapsed_s: Callable[[], float] = time.perf_counter
    processor_s: Callable[[], float] = time.thread_time


CLOCKS = Clocks()

T = TypeVar("T")


class LoopTime:
    """The time of one event loop that clients' messages may take. Lives on that loop.

    Tokens of its bucket are seconds. While all together take more than their share of the loop, peers have equal parts
    of it, and of a peer its streams; who takes no more than that is not held back. taken_s: so far. num_held: times
    that a stream was not read on for what it had taken.
    """

    def __init__(self, share: float = UNLIMITED, now: float = 0.0, clocks: Clocks = CLOCKS) -> None:
        """share: of the loop's time, seconds a second."""
        self.bucket = TokenBucket(share, now)
        self._used_by: Counter[Hashable] = Counter()
        self.taken_s = 0.0
        self.num_held = 0
        self.clocks = clocks

    @property
    def num_peers(self) -> int:
        """With streams, or calls whose requests are worked for."""
        return len(self._used_by)

    def serves(self, peer: Hashable) -> bool:
        """Whether it is one of them."""
        return peer in self._used_by

    def enter(self, peer: Hashable) -> None:
        """A stream or call of a peer begins."""
        self._used_by[peer] += 1

    def leave(self, peer: Hashable) -> None:
        """One of them is over."""
        self._used_by[peer] -= 1
        if not self._used_by[peer]:
            del self._used_by[peer]


class Work:
    """What the event loop does for one stream or call: `with work:` around all of it that does not await.

    Blocks may lie in each other: the outermost counts. `end` and `begin` leave out a wait within one. num_events,
    num_refused: of the present block, counted by who takes them.
    """

    __slots__ = ("_began_s", "_charge", "_computed_s", "_depth", "_loop_time", "num_events", "num_refused")

    def __init__(self, loop_time: LoopTime, charge: Callable[[float], None]) -> None:
        """charge: takes what a block took, seconds."""
        self._loop_time = loop_time
        self._charge = charge
        self._depth = 0
        self.num_events = self.num_refused = 0
        self._began_s = self._computed_s = 0.0

    def begin(self) -> None:
        """What follows is done for the stream."""
        if not self._depth:
            elapsed_s, processor_s = self._loop_time.clocks
            self._began_s, self._computed_s = elapsed_s(), processor_s()
        self._depth += 1

    def end(self) -> None:
        """It is done, or waits."""
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
        """What a coroutine gives: what the loop does for it counts, and what it waits for does not."""
        return await _Steps(self, begin())

    def __enter__(self) -> None:
        self.begin()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()


class _Steps(Generic[T]):
    """A coroutine from one wait to the next, each step of which is work: as `yield from` does it (PEP 380)."""

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
            except BaseException as error:  # a cancellation most of all
                step = partial(self._coroutine.throw, error)
