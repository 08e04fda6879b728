"""The Python client and the service with a connection that is cut, falls silent, or leads to another server."""

from __future__ import annotations

import asyncio

import pytest

from motiongen_client import (
    LinePolicy,
    Playback,
    SessionOptions,
    StreamLost,
)
from tests.e2e.lost_line import LOOKAHEAD, Received, a_server, check_history, played, proxied
from tests.server.engine.fakes import CONSTRAINTS, FRAME, PROMPT, SEED
from tests.waiting import LIMIT_S, until_true

pytestmark = pytest.mark.usefixtures("short_delays")


async def test_session_is_reopened_from_the_frames_held_after_its_grace(
    received: dict[Playback, Received],
) -> None:
    async with asyncio.timeout(LIMIT_S), a_server(resume_grace_s=0.05) as server, proxied(server) as (proxy, client):
        session = await client.open("first", options=SessionOptions(lookahead_frames=80, seed=5))
        await session.set_prompt("second one")
        session.add_waypoint(1, 2, frame=5000)
        assert await played(session, 60) == list(range(60))
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not server.engine.num_sessions)
        waiting = session.set_prompt("third, while away")
        told: list[object] = []
        session.on_reopened = told.append
        proxy.is_shut = False
        outcome = await waiting
        (reopened,) = session.reopenings
        assert told == [reopened]
        assert "SESSION_NOT_KEPT" in reopened.reason
        assert outcome.effective_frame is not None
        assert outcome.effective_frame >= reopened.frame
        rest = await played(session, 200)
        assert rest == list(range(60, 260)), "frame numbers continue for the application"
        rows = received[session.playback].rows
        assert rows[reopened.frame][FRAME] == 0, "the new session's first frame"
        assert rows[reopened.frame][SEED] == 5
        assert rows[outcome.effective_frame + 1][PROMPT] == len("third, while away")
        assert rows[outcome.effective_frame - 1][PROMPT] == len("second one")
        assert rows[259][CONSTRAINTS] == 0, "a constraint this far ahead is not in the window yet"
        assert session.stats.reopenings == 1
        assert (await session.close()).reason == "client"
        check_history(server, reopened.frame)


async def test_another_server_continues_the_sessions_of_one_that_was_killed() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server() as other, a_server() as server, proxied(server) as (proxy, client),
    ):  # fmt: skip
        sessions = [await client.open("a person walks", options=LOOKAHEAD) for _ in range(3)]
        for session in sessions:
            await played(session, 50)
        proxy.is_shut = True
        proxy.cut()
        proxy.behind = other.address
        proxy.is_shut = False
        for session in sessions:
            assert await played(session, 150) == list(range(50, 200))
            assert len(session.reopenings) == 1
        assert other.engine.num_sessions == 3
        assert (await client.open("one more")).reopenings == ()
        check_history(other, *(session.reopenings[0].frame for session in sessions))


async def test_session_moves_to_another_server_when_its_own_drains() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server() as other, a_server() as server, proxied(server) as (proxy, client),
    ):  # fmt: skip
        session = await client.open("a person walks", options=LOOKAHEAD)
        await played(session, 50)
        proxy.behind = other.address
        server.service.goodbye(1.0)
        opening = asyncio.create_task(client.open("while it drains"))
        await asyncio.to_thread(lambda: None)
        server.service.close_all()
        assert await played(session, 100) == list(range(50, 150))
        assert "drained" in session.reopenings[0].reason
        assert await played(await opening, 10) == list(range(10))
        assert other.engine.num_sessions == 2
        check_history(other, session.reopenings[0].frame)


async def test_silent_connection_is_noticed_and_the_session_resumed() -> None:
    policy = LinePolicy(ping_s=0.2, pong_timeout_s=0.2, hello_timeout_s=1.0)
    async with asyncio.timeout(LIMIT_S), a_server() as server, proxied(server, policy) as (proxy, client):
        session = await client.open("a person walks", options=LOOKAHEAD)
        await played(session, 50)
        proxy.is_silent = True
        await until_true(lambda: not client.is_connected)
        proxy.is_silent = False
        assert await played(session, 100) == list(range(50, 150))
        assert session.stats.resumes >= 1  # more often if the machine itself stalls for a moment
        assert session.reopenings == ()
        assert server.engine.num_sessions == 1


async def test_client_reconnects_when_a_new_connection_stays_silent() -> None:
    """Connections are accepted but never answered, as by a stalled machine, or a proxy that has lost its server."""
    policy = LinePolicy(ping_s=0.2, pong_timeout_s=0.2, hello_timeout_s=0.5)
    tried: list[None] = []

    def note_connection() -> None:
        tried.append(None)

    async with (
        asyncio.timeout(LIMIT_S), a_server() as server, proxied(server, policy, note_connection) as (proxy, client),
    ):  # fmt: skip
        session = await client.open("a person walks", options=LOOKAHEAD)
        await played(session, 50)
        before = len(tried)
        proxy.is_silent = True
        await until_true(lambda: len(tried) >= before + 3)
        proxy.is_silent = False
        assert await played(session, 100) == list(range(50, 150))


async def test_without_recovery_sessions_fail_and_new_ones_can_open() -> None:
    policy = LinePolicy(recover_s=0)
    async with asyncio.timeout(LIMIT_S), a_server() as server, proxied(server, policy) as (proxy, client):
        session = await client.open("a person walks")
        proxy.cut()
        with pytest.raises(StreamLost):
            await played(session, 1000)
        other = await client.open("another")
        assert await played(other, 10) == list(range(10))


async def test_session_closed_during_an_outage_ends_at_once_and_later_on_the_server() -> None:
    async with asyncio.timeout(LIMIT_S), a_server(resume_grace_s=0.2) as server, proxied(server) as (proxy, client):
        session, other = await client.open("one"), await client.open("two")
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not client.is_connected)
        assert (await session.close()).reason == "client"
        proxy.is_shut = False
        assert await played(other, 10) == list(range(10))
        await until_true(lambda: server.engine.num_sessions == 1)


async def test_paused_session_is_still_paused_when_reopened() -> None:
    async with asyncio.timeout(LIMIT_S), a_server(resume_grace_s=0.05) as server, proxied(server) as (proxy, client):
        session = await client.open("one", options=LOOKAHEAD)
        await played(session, 10)
        await session.pause()
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not server.engine.num_sessions)
        proxy.is_shut = False
        await until_true(lambda: session.reopenings)
        assert (await session.resume()).event_seq == 3, "number 1 is the open, 2 the pause that is repeated"
        assert len(await played(session, 100)) == 100
        check_history(server, session.reopenings[0].frame)


async def test_stream_without_sessions_reconnects_when_one_is_opened() -> None:
    async with asyncio.timeout(LIMIT_S), a_server() as server, proxied(server) as (proxy, client):
        await (await client.open("one")).close()
        proxy.cut()
        await until_true(lambda: not client.is_connected)
        await until_true(lambda: not server.service.num_streams)
        assert await played(await client.open("another"), 10) == list(range(10))
        assert server.engine.num_sessions == 1
