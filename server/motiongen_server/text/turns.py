"""Turns: who is next at the encoder. Peers go round, and within each those who ask, however much any of them asks."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from typing import NamedTuple


class Asker(NamedTuple):
    """Who asks: a stream or a call by its number, and the name of the peer that it is counted for."""

    peer: str = ""
    number: int = 0


class PlaceLost(Exception):
    """All places are taken by those who have no more, or this one was given up for somebody who has less."""


class Place:
    """Where one who asks waits, or several peers who ask for the same."""

    __slots__ = ("called", "numbers")

    def __init__(self, asker: Asker) -> None:
        self.numbers = {asker.peer: asker.number}  # of each peer, the first that asked
        self.called: asyncio.Future[None] | None = None


class _Line:
    """The places of one peer: each who asks has a queue."""

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
        """Who has most; of equals the one who was served last."""
        return max(reversed(self.queues), key=self.num_of)


class Turns:
    """So many at once, and so many who have a turn or wait. Used from the event loop only."""

    def __init__(self, at_once: int, most: int) -> None:
        """most: places in all, of those whose turn it is too."""
        self._at_once = at_once
        self._most = most
        self._num_serving = 0
        self._num_waiting = 0
        self._lines: OrderedDict[str, _Line] = OrderedDict()  # of peers, the one served longest ago first

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
                self.give_back()  # it was called in the same moment
            elif place.called.cancelled():
                self._leave(place)
            raise

    def join(self, place: Place, asker: Asker) -> None:
        """Another asks for the same: the place is served at whichever turn comes first, and lost when both lose it."""
        if asker.peer in place.numbers:
            return
        if place.called is None:
            place.numbers[asker.peer] = asker.number
        elif not place.called.done():
            place.numbers[asker.peer] = asker.number
            self._enter(asker.peer, asker.number, place)

    def give_back(self) -> None:
        """End a turn; the next begins: of the peer served longest ago, and there of who was served longest ago."""
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
            if place.called is not None and not place.called.done():  # who gives up waiting may not have left yet
                self._num_serving += 1
                place.called.set_result(None)
                return

    def _make_room(self, place: Place) -> bool:
        """Have another place given up for this one. Whether there is one, of somebody who has more."""
        for asker in place.numbers.items():
            while (most := self._who_has_more(*asker)) is not None:
                if self._give_up(*most):
                    return True
        return False

    def _who_has_more(self, peer: str, number: int) -> tuple[str, int] | None:
        """The peer that has most, if that is more than this one would have; else such a one of this peer."""
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
        """Take the newest place of one who asks. Whether nobody has it any more."""
        place = self._lines[peer].queues[number][-1]
        if len(place.numbers) > 1:  # others wait with it
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
        """It waits no more. Does nothing where it has left."""
        for peer, number in place.numbers.items():
            self._go(peer, number, place)
        if place.numbers:
            self._num_waiting -= 1
            place.numbers.clear()
