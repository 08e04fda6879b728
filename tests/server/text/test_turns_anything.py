"""Turns under arbitrary sequences of asking, leaving, joining and serving."""

from __future__ import annotations

import asyncio
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import TypeAlias

from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.text.turns import Asker, Place, Turns
from tests.server.text.test_turns import rest
from tests.waiting import LIMIT_S

Step: TypeAlias = tuple[str, int, Asker]
"""The kind of step, the index of a waiting place, and the asker."""

ASKERS = st.builds(Asker, st.sampled_from("abc"), st.integers(0, 3))
INDEXES = st.integers(0, 30)
WITHOUT_JOINS = st.tuples(st.sampled_from(["ask", "ask", "serve", "leave"]), INDEXES, ASKERS)
ALL = st.tuples(st.sampled_from(["ask", "ask", "serve", "leave", "join"]), INDEXES, ASKERS)


class Played:
    """Turns, and the outcome of each request. With at_once = 1 the calls have an order."""

    def __init__(self, at_once: int, most: int) -> None:
        self.turns = Turns(at_once, most)
        self.at_once, self.most = at_once, most
        self.serving = 0
        self.waiting: dict[Place, tuple[Asker, asyncio.Task[None]]] = {}
        self.lost: list[Asker] = []
        self.called: list[Asker] = []

    async def do(self, step: Step) -> None:
        kind, index, asker = step
        place = list(self.waiting)[index % len(self.waiting)] if self.waiting else None
        if kind == "ask":
            place = Place(asker)
            self.waiting[place] = asker, asyncio.create_task(self.turns.take(place))
        elif kind == "serve" and self.serving:
            self.serving -= 1
            self.turns.give_back()
        elif kind == "leave" and place is not None:
            self.waiting[place][1].cancel()
        elif kind == "join" and place is not None:
            self.turns.join(place, asker)
        await self.look()

    async def look(self) -> None:
        """Record the outcomes; check that no turn is free while an asker waits, and that the places are bounded."""
        await rest()
        for place, (asker, task) in list(self.waiting.items()):
            if task.done():
                del self.waiting[place]
                if not task.cancelled():
                    (self.lost if task.exception() else self.called).append(asker)
                    self.serving += task.exception() is None
        assert self.serving + len(self.waiting) <= self.most
        assert self.serving == self.at_once or not self.waiting

    @property
    def num_waiting(self) -> Counter[str]:
        return Counter(asker.peer for asker, _ in self.waiting.values())

    async def end(self) -> None:
        """Serve all that still wait, and check that no turn was lost."""
        while self.serving:
            await self.do(("serve", 0, Asker()))
        assert not self.waiting
        async with asyncio.timeout(LIMIT_S):
            for _ in range(self.at_once):
                await self.turns.take(Place(Asker()))


@given(at_once=st.integers(1, 3), most=st.integers(3, 8), steps=st.lists(ALL, max_size=60))
def test_places_are_bounded_and_every_turn_is_used(at_once: int, most: int, steps: list[Step]) -> None:
    async def play() -> None:
        played = Played(at_once, most)
        for step in steps:
            await played.do(step)
        await played.end()

    asyncio.run(play())


@given(most=st.integers(3, 12), steps=st.lists(WITHOUT_JOINS, max_size=80))
def test_place_is_lost_only_by_the_peer_with_most(most: int, steps: Sequence[Step]) -> None:
    async def play() -> None:
        played = Played(1, most)
        for step in steps:
            before, num_lost = played.num_waiting, len(played.lost)
            is_full = played.serving + before.total() >= most
            await played.do(step)
            lost = [asker.peer for asker in played.lost[num_lost:]]
            assert len(lost) == (is_full and step[0] == "ask"), "one place, and only when the queue is full"
            for peer in lost:
                of_peer = before[peer] + (peer == step[2].peer)
                assert of_peer == max((before + Counter([step[2].peer])).values()), "the peer that would have most"
        await played.end()

    asyncio.run(play())


@given(steps=st.lists(WITHOUT_JOINS, max_size=80))
def test_no_peer_is_called_twice_while_another_waits(steps: Sequence[Step]) -> None:
    async def play() -> None:
        played = Played(1, 1000)
        since: defaultdict[str, Counter[str]] = defaultdict(Counter)  # by waiting peer: the calls of others since
        for step in steps:
            before, num_called = played.num_waiting, len(played.called)
            await played.do(step)
            for asker in played.called[num_called:]:
                since.pop(asker.peer, None)
                for peer in before:
                    if peer != asker.peer:
                        since[peer][asker.peer] += 1
                        assert since[peer][asker.peer] <= 1
            for peer in set(since) - set(played.num_waiting):
                del since[peer]
        await played.end()

    asyncio.run(play())
