"""Turns: who is next at the encoder: those who ask go round, however much one of them asks."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque


class PlaceLost(Exception):
    """Who asked for most had to give up a place for one who asked for less."""


class Turns:
    """So many at once. Each owner has a queue of its own. Used from the event loop only."""

    def __init__(self, at_once: int) -> None:
        self._free = at_once
        self._queues: OrderedDict[int, deque[asyncio.Future[None]]] = OrderedDict()

    async def take(self, owner: int) -> None:
        """Wait for a turn; `give_back` ends it. Raises PlaceLost."""
        if self._free:
            self._free -= 1
            return
        called: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._queues.setdefault(owner, deque()).append(called)
        try:
            await called
        except asyncio.CancelledError:
            if called.done() and not called.cancelled() and called.exception() is None:
                self.give_back()  # it was called in the same moment
            else:
                self._forget(owner, called)
            raise

    def give_back(self) -> None:
        """End a turn; the next begins: of the owner who was served longest ago."""
        if not self._queues:
            self._free += 1
            return
        owner, queue = self._queues.popitem(last=False)
        queue.popleft().set_result(None)
        if queue:
            self._queues[owner] = queue

    def make_room(self, owner: int) -> bool:
        """Take the newest place from the owner who has most, if that is more than this one has."""
        if not self._queues:
            return False
        most = max(self._queues, key=lambda name: len(self._queues[name]))
        if len(self._queues[most]) <= len(self._queues.get(owner, ())) + 1:
            return False
        newest = self._queues[most][-1]
        self._forget(most, newest)
        newest.set_exception(PlaceLost())
        return True

    def _forget(self, owner: int, called: asyncio.Future[None]) -> None:
        queue = self._queues.get(owner)
        if queue is not None and called in queue:
            queue.remove(called)
            if not queue:
                del self._queues[owner]
