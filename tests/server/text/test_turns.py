"""Who asks the encoder for much does not keep others waiting, nor take their places."""

from __future__ import annotations

import asyncio

import pytest

from motiongen_server.text.turns import PlaceLost, Turns
from tests.waiting import LIMIT_S

GREEDY, MODEST = 1, 2


async def rest() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


async def test_owners_go_round() -> None:
    turns, order = Turns(1), []
    await turns.take(0)

    async def ask(owner: int) -> None:
        await turns.take(owner)
        order.append(owner)

    asked = [asyncio.create_task(ask(owner)) for owner in [GREEDY] * 5 + [MODEST] * 2]
    await rest()
    for _ in asked:
        turns.give_back()
        await rest()
    assert order == [GREEDY, MODEST, GREEDY, MODEST, GREEDY, GREEDY, GREEDY]


async def test_who_has_most_gives_up_a_place_for_who_has_less() -> None:
    turns = Turns(1)
    await turns.take(0)
    greedy = [asyncio.create_task(turns.take(GREEDY)) for _ in range(4)]
    await rest()
    assert turns.make_room(MODEST)
    assert not turns.make_room(GREEDY), "nobody has more"
    await rest()
    with pytest.raises(PlaceLost):
        greedy[-1].result()
    assert not any(task.done() for task in greedy[:-1])
    for task in greedy[:-1]:
        task.cancel()


async def test_who_gives_up_waiting_leaves_no_turn_behind() -> None:
    turns = Turns(1)
    await turns.take(0)
    waiting, called = asyncio.create_task(turns.take(1)), asyncio.create_task(turns.take(2))
    await rest()
    waiting.cancel()
    await rest()
    turns.give_back()
    called.cancel()  # in the moment in which it is called
    await rest()
    async with asyncio.timeout(LIMIT_S):
        await turns.take(3)
