"""More edits than a session may say in a second are made while the line is lost: none is refused for that."""

from __future__ import annotations

import asyncio

import pytest

from tests.e2e.lost_line import LOOKAHEAD, a_server, played, proxied
from tests.waiting import LIMIT_S, until_true

pytestmark = pytest.mark.usefixtures("short_delays")


async def test_all_edits_of_a_lost_line_are_taken_when_it_is_back() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server(events_per_second=80.0) as server, proxied(server) as (proxy, client),
    ):  # fmt: skip
        session = await client.open("a person walks", options=LOOKAHEAD)
        await played(session, 50)
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not client.is_connected)
        edits = [session.set_prompt(f"prompt {number}") for number in range(85)]
        edits += [session.set_velocity(0.01 * number, 0.0) for number in range(1000)]
        proxy.is_shut = False
        outcomes = await asyncio.gather(*edits)
        assert [outcome.event_seq for outcome in outcomes] == [*range(2, 87), *[87] * 1000]
        assert session.stats.resumes >= 1
