"""Servers that share a Redis: when one is full, sessions open or resume on another one."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
import redis

from motiongen_client import EventRefused, MotionClient, Session
from motiongen_server.replicas.directory import SERVERS
from tests.e2e.tcp_proxy import TcpProxy
from tests.scale.proxies import CERTIFICATES, HaProxy
from tests.scale.replicas import NULL_SERVER, Replicas
from tests.waiting import until, until_true

pytestmark = pytest.mark.system

ROOM = 3
"""The number of sessions that each server admits."""


@pytest.fixture
def replicas(tmp_path: Path) -> Iterator[Replicas]:
    with Replicas(tmp_path, 2, ("--max-sessions", str(ROOM)), program=NULL_SERVER) as running:
        yield running


def come_to(replicas: Replicas, *counts: int) -> None:
    """Wait until the servers' metrics, which lag behind a little, show these numbers of sessions."""
    until(lambda: tuple(each.metric("motiongen_sessions") for each in replicas.all) == counts)


def know_each_other(replicas: Replicas) -> None:
    others = len(replicas.all) - 1
    until(lambda: all(each.metric("motiongen_other_servers") == others for each in replicas.all))


async def plays(session: Session) -> None:
    """Check that edits are answered and frames come."""
    held = session.playback.buffered_to
    await session.set_prompt("a person runs forward")
    async for _ in session.frames(0.5):
        pass
    await until_true(lambda: session.playback.buffered_to > held)


async def opened(client: MotionClient, replicas: Replicas) -> Session:
    """Open a session, once a server has room: a server that stalls for seconds is forgotten for a while."""
    while True:
        try:
            return await client.open("a person walks forward")
        except EventRefused as refusal:
            if refusal.reason != "SESSION_LIMIT":
                raise
        await asyncio.to_thread(know_each_other, replicas)


async def test_client_opens_sessions_on_the_server_with_room(replicas: Replicas) -> None:
    first, second = replicas.all
    await asyncio.to_thread(know_each_other, replicas)
    async with MotionClient(first.address, other_addresses=[second.address]) as client:
        sessions = [await opened(client, replicas) for _ in range(ROOM + 2)]
        await asyncio.to_thread(come_to, replicas, ROOM, 2)
        for session in sessions:
            await plays(session)
        sessions.append(await opened(client, replicas))
        with pytest.raises(EventRefused, match="SESSION_LIMIT"):
            await client.open("a person stands")
        for session in sessions:
            assert (session.stats.resumes, session.reopenings) == (0, ())


async def test_behind_a_proxy_the_key_leads_to_the_server_with_room(replicas: Replicas, tmp_path: Path) -> None:
    credentials = grpc.ssl_channel_credentials((CERTIFICATES / "authority.pem").read_bytes())
    await asyncio.to_thread(know_each_other, replicas)
    with HaProxy(tmp_path, replicas.behind) as proxy:
        scouts = [MotionClient(proxy.address, credentials=credentials) for _ in range(8)]
        for scout in scouts:  # so that each server has seen a key that leads to it
            await scout.connect()
        await asyncio.to_thread(until, lambda: all(named(replicas)))
        async with MotionClient(proxy.address, credentials=credentials) as client:
            sessions = [await opened(client, replicas) for _ in range(2 * ROOM)]
            await asyncio.to_thread(come_to, replicas, ROOM, ROOM)
            for session in sessions:
                await plays(session)
        for scout in scouts:
            await scout.close()


def named(replicas: Replicas) -> list[bool]:
    """For each server, whether it has told a key that leads to it."""
    client = redis.Redis.from_url(replicas.store)
    told = [json.loads(each) for each in client.hgetall(SERVERS).values()]
    client.close()
    return [bool(each["key"]) for each in told]


async def test_session_resumes_on_a_third_server_if_the_next_has_no_room(tmp_path: Path) -> None:
    with Replicas(tmp_path, 3, ("--max-sessions", str(ROOM)), program=NULL_SERVER) as replicas:
        first, second, third = replicas.all
        await asyncio.to_thread(know_each_other, replicas)
        async with (
            TcpProxy(first.address) as line,
            MotionClient(second.address) as filling,
            MotionClient(line.address, other_addresses=[third.address]) as client,
        ):
            for _ in range(ROOM):
                await filling.open("a person stands")
            sessions = [await client.open("a person walks forward") for _ in range(2)]
            for session in sessions:
                await plays(session)
            await until_true(lambda: all(session.is_durable for session in sessions))
            line.behind = second.address
            line.cut()
            await until_true(lambda: all(session.stats.resumes == 1 for session in sessions))
            for session in sessions:
                await plays(session)
                assert session.reopenings == ()
            await asyncio.to_thread(until, lambda: third.metric("motiongen_sessions") == 2)
