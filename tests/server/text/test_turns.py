"""Turns at the encoder: a peer with many requests, on any number of streams, neither delays nor displaces others."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence

from motiongen_server.text.turns import Asker, Place, PlaceLost, Turns
from tests.waiting import LIMIT_S

MANY = 1_000


def streams(peer: str, count: int) -> list[Asker]:
    return [Asker(peer, number) for number in range(count)]


class Crowd:
    """Askers of a single turn, which is taken at first. Records who was called and who lost a place."""

    def __init__(self, most: int = MANY) -> None:
        self.turns = Turns(1, most)
        self.called: list[Asker] = []
        self.lost: list[Asker] = []
        self.tasks: list[asyncio.Task[None]] = []

    async def begin(self) -> Crowd:
        await self.turns.take(Place(Asker("the first")))
        return self

    async def _ask(self, asker: Asker, place: Place) -> None:
        try:
            await self.turns.take(place)
        except PlaceLost:
            self.lost.append(asker)
        else:
            self.called.append(asker)

    async def ask(self, askers: Sequence[Asker]) -> list[Place]:
        """Queue each of them, in this order."""
        places = [Place(asker) for asker in askers]
        for asker, place in zip(askers, places, strict=True):
            self.tasks.append(asyncio.create_task(self._ask(asker, place)))
            await rest()
        return places

    async def serve(self, count: int) -> list[Asker]:
        """End `count` turns. Returns who was called."""
        before = len(self.called)
        for _ in range(count):
            self.turns.give_back()
            await rest()
        return self.called[before:]

    async def end(self) -> None:
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*self.tasks, return_exceptions=True)


async def rest() -> None:
    for _ in range(3):
        await asyncio.sleep(0)


GREEDY, MODEST = Asker("one", 1), Asker("one", 2)


async def test_streams_of_a_peer_take_turns() -> None:
    crowd = await Crowd().begin()
    await crowd.ask([GREEDY] * 5 + [MODEST] * 2)
    assert await crowd.serve(7) == [GREEDY, MODEST, GREEDY, MODEST, GREEDY, GREEDY, GREEDY]


async def test_peers_take_turns_however_many_streams_one_has() -> None:
    crowd = await Crowd().begin()
    await crowd.ask(streams("hostile", 50))
    await crowd.ask([Asker("good", 1)] * 2)
    called = await crowd.serve(6)
    assert [asker.peer for asker in called] == ["hostile", "good", "hostile", "good", "hostile", "hostile"]
    assert [asker.number for asker in called if asker.peer == "hostile"] == [0, 1, 2, 3]
    await crowd.end()


async def test_fullest_stream_of_a_peer_loses_its_newest_place() -> None:
    crowd = await Crowd(most=5).begin()
    await crowd.ask([GREEDY] * 4)
    await crowd.ask([MODEST])
    assert crowd.lost == [GREEDY]
    await crowd.ask([GREEDY])
    assert crowd.lost == [GREEDY, GREEDY], "no other stream has more"
    assert await crowd.serve(4) == [GREEDY, MODEST, GREEDY, GREEDY]


async def test_peer_with_many_streams_loses_places_to_a_peer_with_fewer() -> None:
    crowd = await Crowd(most=51).begin()
    await crowd.ask(streams("hostile", 60))
    assert crowd.lost == streams("hostile", 60)[50:], "all its streams have one place each"
    crowd.lost.clear()
    await crowd.ask(streams("good", 2))
    assert crowd.lost == [Asker("hostile", 49), Asker("hostile", 48)], "those that would have been served last"
    assert (await crowd.serve(2))[1].peer == "good"
    await crowd.end()


async def test_places_and_turns_are_shared_evenly_among_peers() -> None:
    crowd = await Crowd(most=31).begin()
    for peer in ("a", "b", "good"):
        await crowd.ask(streams(peer, 40))
    asked = Counter(asker.peer for asker in streams("a", 40) + streams("b", 40) + streams("good", 40))
    waiting = asked - Counter(asker.peer for asker in crowd.lost)
    assert waiting == {"a": 10, "b": 10, "good": 10}
    assert Counter(asker.peer for asker in await crowd.serve(15)) == {"a": 5, "b": 5, "good": 5}
    await crowd.end()


async def test_asker_with_as_many_places_as_others_displaces_nobody() -> None:
    crowd = await Crowd(most=4).begin()
    await crowd.ask([Asker("a"), Asker("b"), Asker("c"), Asker("d")])
    assert crowd.lost == [Asker("d")]
    await crowd.end()


async def test_cancelled_waiters_leak_no_turn() -> None:
    crowd = await Crowd().begin()
    await crowd.ask([Asker("one"), Asker("two")])
    waiting, called = crowd.tasks
    waiting.cancel()
    await rest()
    crowd.turns.give_back()
    called.cancel()  # cancelled in the moment in which it is called
    await rest()
    async with asyncio.timeout(LIMIT_S):
        await crowd.turns.take(Place(Asker("three")))


async def test_turn_that_ends_as_a_waiter_is_cancelled_goes_to_the_next() -> None:
    crowd = await Crowd().begin()
    await crowd.ask([Asker("one"), Asker("two")])
    crowd.tasks[0].cancel()
    assert await crowd.serve(1) == [Asker("two")]


async def test_waiter_cancelled_as_it_loses_its_place_stays_cancelled() -> None:
    crowd = await Crowd(most=3).begin()
    await crowd.ask([GREEDY] * 2)
    asking = asyncio.create_task(crowd.turns.take(Place(Asker("another"))))
    await asyncio.sleep(0)  # it has taken the newest place, whose waiter has not run since
    crowd.tasks[1].cancel()
    await rest()
    assert crowd.tasks[1].cancelled()
    await crowd.serve(2)
    assert asking.done()


async def test_joined_place_is_served_at_the_earliest_turn_of_its_askers() -> None:
    crowd = await Crowd().begin()
    *_, last = await crowd.ask(streams("hostile", 50))
    crowd.turns.join(last, Asker("good", 1))
    crowd.turns.join(last, Asker("good", 2))
    assert await crowd.serve(3) == [Asker("hostile", number) for number in (0, 49, 1)]
    await crowd.end()


async def test_shared_place_is_lost_only_when_all_its_askers_lose_it() -> None:
    crowd = await Crowd(most=4).begin()
    *_, newest = await crowd.ask([GREEDY] * 3)
    crowd.turns.join(newest, Asker("good"))
    await crowd.ask([Asker("another")])
    assert crowd.lost == [GREEDY], "the place before it is lost instead"
    assert newest.called is not None
    assert not newest.called.done()
    called = await crowd.serve(3)
    assert sorted(asker.peer for asker in called) == ["another", "one", "one"]


async def test_joining_before_waiting_and_after_being_called_is_harmless() -> None:
    turns = Turns(1, 10)
    place = Place(Asker("one"))
    turns.join(place, Asker("two"))
    await turns.take(place)
    waiting = Place(Asker("three"))
    turns.join(waiting, Asker("four"))
    task = asyncio.create_task(turns.take(waiting))
    await rest()
    turns.give_back()
    turns.join(waiting, Asker("five"))
    async with asyncio.timeout(LIMIT_S):
        await task
        turns.give_back()
        await turns.take(Place(Asker("six")))
