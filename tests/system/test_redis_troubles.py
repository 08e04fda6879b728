"""A real Redis that hangs, is full, restarts, or fails over: sessions play on, and clients are told of it."""

from __future__ import annotations

import asyncio
import signal
import subprocess
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
import redis

from motiongen_client import LinePolicy, MotionClient, Session, SessionOptions
from motiongen_server.snapshots import writer
from motiongen_server.snapshots.redis_store import RedisStore
from tests.contract.local import LocalServer
from tests.e2e.lost_line import FACTS_AS_SERVED
from tests.e2e.tcp_proxy import TcpProxy
from tests.scale.proxies import free_port
from tests.server.engine.fakes import FRAME
from tests.system.real_redis import start_redis, url_in
from tests.waiting import LIMIT_S, until, until_true

pytestmark = pytest.mark.system

OPTIONS = SessionOptions(lookahead_frames=80)


@pytest.fixture(autouse=True)
def short_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "RETRY_S", 0.05)
    monkeypatch.setattr(writer, "RENEW_EVERY_S", 0.2)


class RealRedis:
    """A Redis of the test's own, on a socket and on a port. process: a test may stop and kill it."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder, self.port = folder, free_port()
        self.process = self._started()

    def _started(self) -> subprocess.Popen[bytes]:
        return start_redis(self.folder, "--port", str(self.port))

    @property
    def client(self) -> redis.Redis:
        return redis.Redis.from_url(url_in(self.folder))

    def start_again(self) -> None:
        self.process = self._started()

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


@pytest.fixture
def one(tmp_path: Path) -> Iterator[RealRedis]:
    server = RealRedis(tmp_path / "one")
    yield server
    server.end()


class Played(NamedTuple):
    """A saved session, the durability reports that it gets from now on, its server, and the proxy in front of it."""

    session: Session
    told: list[bool]
    server: LocalServer
    line: TcpProxy


@asynccontextmanager
async def playing(url: str) -> AsyncIterator[Played]:
    """A session whose server saves it in the Redis at that URL."""
    server = LocalServer(facts=FACTS_AS_SERVED, snapshots=RedisStore(url, 60))
    async with (
        asyncio.timeout(LIMIT_S),
        server,
        TcpProxy(server.address) as line,
        MotionClient(line.address, policy=LinePolicy()) as client,
    ):
        session = await client.open("first", options=OPTIONS)
        await frames_of(session, 20)
        await until_true(lambda: session.is_durable)
        told: list[bool] = []
        session.on_durability = told.append
        yield Played(session, told, server, line)


async def frames_of(session: Session, count: int) -> list[int]:
    """The numbers of the next frames, played as fast as they come."""
    numbers: list[int] = []
    async for frame in session.frames(realtime=False):
        numbers.append(int(session.playback.row(frame.index)[FRAME]))
        if len(numbers) == count:
            break
    return numbers


async def is_served_on(session: Session) -> None:
    """Check that an edit is answered and takes effect, and that no frame is left out or repeated."""
    answer = await session.set_prompt("x" * (1 + session.playback.playhead % 500))
    numbers = await frames_of(session, 60)
    assert numbers == list(range(numbers[0], numbers[0] + 60))
    assert answer.effective_frame is not None
    assert session.reopenings == ()


async def test_hanging_redis_delays_no_session(one: RealRedis) -> None:
    async with playing(url_in(one.folder)) as (session, told, server, _):
        one.process.send_signal(signal.SIGSTOP)
        try:
            await is_served_on(session)
            await until_true(lambda: told == [False])
            await is_served_on(session)
            durability = server.service.durability
            assert durability is not None
            assert durability.writer.is_failing
        finally:
            one.process.send_signal(signal.SIGCONT)
        await until_true(lambda: told == [False, True])
        await is_served_on(session)


async def test_full_redis_is_reported_and_used_again_once_there_is_room(one: RealRedis) -> None:
    async with playing(url_in(one.folder)) as (session, told, _, _):
        one.client.config_set("maxmemory", "1")
        await is_served_on(session)
        await until_true(lambda: told == [False])
        one.client.config_set("maxmemory", "0")
        await is_served_on(session)
        await until_true(lambda: told == [False, True])


async def test_restarted_empty_redis_gets_every_session_again(one: RealRedis) -> None:
    async with playing(url_in(one.folder)) as (session, told, _, _):
        one.end()
        await is_served_on(session)
        await until_true(lambda: told == [False])
        one.start_again()
        await is_served_on(session)
        await until_true(lambda: session.is_durable)
        assert one.client.dbsize() == 1


async def test_paused_session_is_saved_again_in_an_emptied_redis(one: RealRedis) -> None:
    async with playing(url_in(one.folder)) as (session, told, _, _):
        await session.pause()
        await until_true(lambda: session.durable_seq == session.last_seq)
        one.client.flushall()
        await until_true(lambda: told[-2:] == [False, True])
        assert one.client.dbsize() == 1


async def test_after_a_failover_another_server_continues_from_the_redis_replica(one: RealRedis, tmp_path: Path) -> None:
    """Primary and replica are behind one address: the primary dies, and the replica is promoted."""
    replica = RealRedis(tmp_path / "two")
    try:
        replica.client.replicaof("127.0.0.1", str(one.port))  # type: ignore[no-untyped-call]
        until(lambda: replica.client.info("replication").get("master_link_status") == "up")
        async with TcpProxy(f"127.0.0.1:{one.port}") as address:
            url = f"redis://{address.address}/0"
            async with playing(url) as (session, told, first, line):
                one.end()
                address.cut()
                await is_served_on(session)
                await until_true(lambda: told == [False])
                replica.client.replicaof("NO", "ONE")  # type: ignore[no-untyped-call]
                address.behind = f"127.0.0.1:{replica.port}"
                await is_served_on(session)
                await until_true(lambda: session.is_durable and session.durable_seq == session.last_seq)
                durability = first.service.durability
                assert durability is not None
                await until_true(lambda: durability.writer.lag_s == 0.0)
                async with LocalServer(facts=FACTS_AS_SERVED, snapshots=RedisStore(url, 60)) as second:
                    line.behind = second.address
                    line.cut()
                    await is_served_on(session)
                    assert (session.stats.resumes, second.engine.num_sessions) == (1, 1)
                    await until_true(lambda: not first.engine.num_sessions)  # the first server has given up the session
                    await session.close()
    finally:
        replica.end()
