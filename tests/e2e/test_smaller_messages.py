"""A server takes smaller messages than what there is to tell it: one that would be greater costs the whole stream."""

from __future__ import annotations

import asyncio

import pytest

from tests.e2e.lost_line import LOOKAHEAD, a_server, played, proxied
from tests.waiting import LIMIT_S, until_true

pytestmark = pytest.mark.usefixtures("short_delays")


async def test_a_server_that_takes_less_than_the_one_before_is_told_in_smaller_messages() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server(max_request_bytes=2000) as other, a_server() as server,
        proxied(server) as (proxy, client),
    ):  # fmt: skip
        session = await client.open("a person walks", options=LOOKAHEAD)
        await played(session, 50)
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not client.is_connected)
        edits = [session.set_prompt(f"{number} " + "x" * 200) for number in range(20)]  # in one message, 5000 bytes
        proxy.behind = other.address
        proxy.is_shut = False
        outcomes = await asyncio.gather(*edits)
        assert [outcome.event_seq for outcome in outcomes] == list(range(2, 22))
        assert len(session.reopenings) == 1
