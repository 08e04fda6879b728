"""Edits made during an outage, more than the rate limit allows in a second, are all accepted afterwards."""

from __future__ import annotations

import asyncio

import pytest

from tests.e2e.lost_line import LOOKAHEAD, a_server, played, proxied
from tests.waiting import LIMIT_S, until_true

pytestmark = pytest.mark.usefixtures("short_delays")


async def test_all_edits_made_during_an_outage_are_accepted_afterwards() -> None:
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
