"""Floods are granted no more than their rate limits, with every kind of message, on one stream and on many.

A busy machine can only make these tests easier to pass: a stream is followed until it was granted the tokens of some
seconds, and that must have taken these seconds, less the one that is free.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from tests.attack.account import FLOODS, Flood, Given, flood, playheads
from tests.attack.server import Attacked, attacked
from tests.waiting import LIMIT_S

STREAM_RATE = 400.0
PEER_RATE = 2_000.0
SECONDS_WORTH = 5.0
ADDRESS_SECONDS_WORTH = 7.0
STREAMS = 12


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Attacked]:
    """A server with low rate limits, which any machine could exceed."""
    rates = ("--stream-events-per-second", f"{STREAM_RATE:g}", "--peer-events-per-second", f"{PEER_RATE:g}")
    with attacked(tmp_path_factory.mktemp("account") / "log", rates) as server:
        yield server


async def test_stream_is_granted_no_more_than_its_rate_whatever_it_sends(server: Attacked) -> None:
    def enough(given: Given) -> bool:
        return given.tokens >= SECONDS_WORTH * STREAM_RATE

    async with asyncio.timeout(LIMIT_S):
        found = await asyncio.gather(*(flood(server.address, each, enough) for each in FLOODS))
    by_name = {each.name: given for each, given in zip(FLOODS, found, strict=True)}
    assert {name: given.lost for name, given in by_name.items() if given.lost} == {}
    # One second's worth is free at the start.
    excess = {name: given.tokens - STREAM_RATE * (given.seconds + 1) for name, given in by_name.items()}
    assert {name: tokens for name, tokens in excess.items() if tokens > 0} == {}


async def test_address_is_granted_no_more_than_its_rate_over_all_its_streams(server: Attacked) -> None:
    of = Flood("50 playheads", lambda number: playheads(50), cost=50.0)
    given_to: dict[int, Given] = {}

    async def one(number: int) -> Given:
        def enough(given: Given) -> bool:
            given_to[number] = given
            return sum(each.tokens for each in given_to.values()) >= ADDRESS_SECONDS_WORTH * PEER_RATE

        return await flood(server.address, of, enough)

    async with asyncio.timeout(LIMIT_S):
        found = await asyncio.gather(*(one(number) for number in range(STREAMS)))
    assert [given.lost for given in found if given.lost] == []
    tokens, seconds = sum(given.tokens for given in found), max(given.seconds for given in found)
    # Free at the start: one second's worth for the first stream, and for each later one its equal share of a second.
    free_s = sum(1 / number for number in range(1, 1 + STREAMS))
    assert tokens <= PEER_RATE * (seconds + free_s)
