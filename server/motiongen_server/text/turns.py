"""Turns: who is served next at the text encoder or at the store of sessions.

Peers are served in rotation, and within each peer its streams and calls, however many requests any of them has.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from typing import NamedTuple


class Asker(NamedTuple):
    """Who asks: the number of a stream or call, and the name of the peer that it counts for."""

    peer: str = ""
    number: int = 0


class PlaceLost(Exception):
    """All places are taken and nobody has more than this asker, or this place was given up for an asker with fewer."""


class Place:
    """A place in the queue of an asker, or of one asker of each of several peers that want the same result."""

    __slots__ = ("called", "numbers")

    def __init__(self, asker: Asker) -> None:
        self.numbers = {asker.peer: asker.number}  # by peer: the first of its askers
        self.called: asyncio.Future[None] | None = None


class _Line:
    """The places of one peer, with a queue for each asker."""

    __slots__ = ("num_places", "queues")

    def __init__(self) -> None:
        self.queues: OrderedDict[int, deque[Place]] = OrderedDict()
        self.num_places = 0

    def add(self, number: int, place: Place) -> None:
        self.queues.setdefault(number, deque()).append(place)
        self.num_places += 1

    def remove(self, number: int, place: Place) -> None:
        queue = self.queues[number]
        queue.remove(place)
        self.num_places -= 1
        if not queue:
            del self.queues[number]

    def num_of(self, number: int) -> int:
        return len(self.queues.get(number, ()))

    def longest(self) -> int:
        """The asker with the most places; among equals, the one served last."""
        return max(reversed(self.queues), key=self.num_of)


class Turns:
    """Limits how many are served at once, and how many are served or wait. Used from the event loop only."""

    def __init__(self, at_once: int, most: int) -> None:
        """most: places in all, including those being served."""
        self._at_once = at_once
        self._most = most
        self._num_serving = 0
        self._num_waiting = 0
        self._lines: OrderedDict[str, _Line] = OrderedDict()  # by peer, the one served longest ago first

    async def take(self, place: Place) -> None:
        """Wait for a turn; `give_back` ends it. Raises PlaceLost."""
        if self._num_serving + self._num_waiting >= self._most and not self._make_room(place):
            raise PlaceLost
        if self._num_serving < self._at_once:
            self._num_serving += 1
            return
        place.called = asyncio.get_running_loop().create_future()
        self._num_waiting += 1
        for peer, number in place.numbers.items():
            self._enter(peer, number, place)
        try:
            await place.called
        except asyncio.CancelledError:
            if not place.called.cancelled() and place.called.exception() is None:
                self.give_back()  # its turn came at the same moment
            elif place.called.cancelled():
                self._leave(place)
            raise

    def join(self, place: Place, asker: Asker) -> None:
        """Let another asker wait for the same: the place is served at the earlier turn, and lost once both lose it."""
        if asker.peer in place.numbers:
            return
        if place.called is None:
            place.numbers[asker.peer] = asker.number
        elif not place.called.done():
            place.numbers[asker.peer] = asker.number
            self._enter(asker.peer, asker.number, place)

    def give_back(self) -> None:
        """End a turn and begin the next, of the peer that was served longest ago and its asker served longest ago."""
        self._num_serving -= 1
        while self._lines:
            peer, line = next(iter(self._lines.items()))
            number, queue = next(iter(line.queues.items()))
            place = queue[0]
            self._leave(place)
            if line.num_places:
                self._lines.move_to_end(peer)
            if number in line.queues:
                line.queues.move_to_end(number)
            if place.called is not None and not place.called.done():  # a cancelled waiter may not have left yet
                self._num_serving += 1
                place.called.set_result(None)
                return

    def _make_room(self, place: Place) -> bool:
        """Take a place from an asker that has more, for this one; returns whether there was one to take."""
        for asker in place.numbers.items():
            while (most := self._who_has_more(*asker)) is not None:
                if self._give_up(*most):
                    return True
        return False

    def _who_has_more(self, peer: str, number: int) -> tuple[str, int] | None:
        """The peer with the most places, if it has more than this one would have, and its asker with the most.

        Otherwise the same within this peer: its asker with the most; None if that has no more either.
        """
        if not self._lines:
            return None
        most = max(reversed(self._lines), key=lambda name: self._lines[name].num_places)
        line, own = self._lines[most], self._lines.get(peer)
        if line.num_places > (0 if own is None else own.num_places) + 1:
            return most, line.longest()
        if own is not None and own.num_of(longest := own.longest()) > own.num_of(number) + 1:
            return peer, longest
        return None

    def _give_up(self, peer: str, number: int) -> bool:
        """Take an asker's newest place from it; returns whether the place is free now."""
        place = self._lines[peer].queues[number][-1]
        if len(place.numbers) > 1:  # other peers wait for it too
            self._go(peer, number, place)
            del place.numbers[peer]
            return False
        self._leave(place)
        if place.called is not None and not place.called.done():
            place.called.set_exception(PlaceLost())
        return True

    def _enter(self, peer: str, number: int, place: Place) -> None:
        self._lines.setdefault(peer, _Line()).add(number, place)

    def _go(self, peer: str, number: int, place: Place) -> None:
        line = self._lines[peer]
        line.remove(number, place)
        if not line.num_places:
            del self._lines[peer]

    def _leave(self, place: Place) -> None:
        """Remove a place from all queues. Does nothing if it was removed before."""
        for peer, number in place.numbers.items():
            self._go(peer, number, place)
        if place.numbers:
            self._num_waiting -= 1
            place.numbers.clear()
