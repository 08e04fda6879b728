"""A session moves to a server with a smaller message limit; a message above it would end the whole stream."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from motiongen_client import InvalidInput
from tests.e2e.lost_line import LOOKAHEAD, a_server, played, proxied
from tests.waiting import LIMIT_S, until_true

pytestmark = pytest.mark.usefixtures("short_delays")


async def test_messages_respect_the_smaller_limit_of_the_next_server() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server(max_request_bytes=2000) as other, a_server() as server,
        proxied(server) as (proxy, client),
    ):  # fmt: skip
        session = await client.open("a person walks", options=LOOKAHEAD)
        await played(session, 50)
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not client.is_connected)
        edits = [session.set_prompt(f"{number} " + "x" * 200) for number in range(20)]  # 5000 bytes in one message
        proxy.behind = other.address
        proxy.is_shut = False
        outcomes = await asyncio.gather(*edits)
        assert [outcome.event_seq for outcome in outcomes] == list(range(2, 22))
        assert len(session.reopenings) == 1


async def test_session_too_large_to_be_reopened_ends_and_others_continue() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server(max_request_bytes=8000) as other, a_server() as server,
        proxied(server) as (proxy, client),
    ):  # fmt: skip
        great, small = [await client.open("a person walks", options=LOOKAHEAD) for _ in range(2)]
        for number in range(3):
            await great.add_trajectory(np.full((400, 2), float(number)), first_frame=5000 + 400 * number)
        for session in (great, small):
            await played(session, 50)
        proxy.is_shut = True
        proxy.cut()
        proxy.behind = other.address
        proxy.is_shut = False
        with pytest.raises(InvalidInput, match="bytes' was given; allowed is at most 7200 bytes in one event"):
            await played(great, 200)
        assert await played(small, 150) == list(range(50, 200))
        assert other.engine.num_sessions == 1


async def test_history_sent_for_reopening_fits_the_message_limit() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server(max_request_bytes=5000) as other, a_server() as server,
        proxied(server) as (proxy, client),
    ):  # fmt: skip
        session = await client.open("a person walks", options=LOOKAHEAD)
        await session.add_trajectory(np.zeros((400, 2)), first_frame=5000)  # 3200 bytes
        await session.set_options(history_frames=40)
        await played(session, 100)
        proxy.is_shut = True
        proxy.cut()
        proxy.behind = other.address
        proxy.is_shut = False
        assert await played(session, 150) == list(range(100, 250))
        assert len(session.reopenings) == 1
