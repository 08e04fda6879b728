"""The Python client and two servers that share a store of snapshots: each can continue the other's sessions."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from motiongen_client import LinePolicy, MotionClient, Session, SessionOptions, backoff, calls
from motiongen_server.replicas.directory import Replica
from motiongen_server.replicas.other_servers import OtherServers
from motiongen_server.rpc.errors import events as event_errors
from motiongen_server.snapshots import writer
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Held, Lease, Renewal, StoreFailed
from tests.contract.local import LocalServer
from tests.e2e.lost_line import FACTS_AS_SERVED
from tests.e2e.tcp_proxy import TcpProxy
from tests.server.engine.fakes import FRAME, PLAN, PROMPT
from tests.server.replicas.told import Told
from tests.waiting import LIMIT_S, until_true

OPTIONS = SessionOptions(lookahead_frames=80)


@pytest.fixture(autouse=True)
def short_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backoff, "LONGEST_DELAY_S", 0.1)
    monkeypatch.setattr(calls, "LAG_S", 0.05)
    monkeypatch.setattr(event_errors, "STORE_RETRY_S", 0.05)
    monkeypatch.setattr(writer, "RETRY_S", 0.02)
    monkeypatch.setattr(writer, "RENEW_EVERY_S", 0.1)


class SharedStore(SqliteStore):
    """The file that two servers share. is_broken: every operation fails and is counted; names: of saved sessions."""

    is_broken, num_failed = False, 0

    def __init__(self, path: Path, keep_s: float) -> None:
        super().__init__(path, keep_s)
        self.names: set[str] = set()

    def save(self, records: Sequence[tuple[Lease, bytes]]) -> list[bool]:
        self._check()
        answers = super().save(records)
        self.names |= {lease.name for lease, _ in records}
        return answers

    def read(self, name: str) -> Held | None:
        self._check()
        return super().read(name)

    def take(self, lease: Lease, holder: str) -> Held | None:
        self._check()
        return super().take(lease, holder)

    def renew(self, leases: Sequence[Lease]) -> list[Renewal]:
        self._check()
        return super().renew(leases)

    def _check(self) -> None:
        if self.is_broken:
            self.num_failed += 1
            raise StoreFailed("the disk is full")


class Pair:
    """Two servers, and a client that is connected to the first through a proxy."""

    def __init__(
        self, stores: tuple[SharedStore, SharedStore], servers: tuple[LocalServer, LocalServer], proxy: TcpProxy
    ) -> None:
        self.stores, self.servers, self.proxy = stores, servers, proxy
        self.client: MotionClient

    def lead_to(self, index: int) -> None:
        """Cut the connection; the next one leads to that server. The other server is not told."""
        self.proxy.is_shut = True
        self.proxy.cut()
        self.proxy.behind = self.servers[index].address
        self.proxy.is_shut = False


@asynccontextmanager
async def pair(path: Path) -> AsyncIterator[Pair]:
    stores = SharedStore(path / "one.sqlite", 60), SharedStore(path / "one.sqlite", 60)
    servers = (
        LocalServer(facts=FACTS_AS_SERVED, snapshots=stores[0]),
        LocalServer(facts=FACTS_AS_SERVED, snapshots=stores[1]),
    )
    async with asyncio.timeout(LIMIT_S), servers[0], servers[1], TcpProxy("") as proxy:
        two = Pair(stores, servers, proxy)
        two.lead_to(0)
        async with MotionClient(proxy.address, policy=LinePolicy()) as two.client:
            yield two


async def played(session: Session, frames: int) -> list[np.ndarray]:
    """Play so many frames as fast as they come. Returns their rows."""
    rows = []
    async for frame in session.frames(realtime=False):
        rows.append(session.playback.row(frame.index))
        if len(rows) == frames:
            break
    return rows


async def saved(session: Session) -> None:
    """Wait until every event of the session is stored."""
    await until_true(lambda: session.is_durable and session.durable_seq == session.last_seq)


async def quiet(two: Pair) -> None:
    """Wait until nothing is waiting to be stored."""
    for server in two.servers:
        durability = server.service.durability
        assert durability is not None
        await until_true(lambda durability=durability: durability.writer.lag_s == 0.0)


async def test_another_server_continues_a_session_from_its_snapshot(tmp_path: Path) -> None:
    async with pair(tmp_path) as two:
        session = await two.client.open("first", options=OPTIONS)
        await session.set_prompt("second one")
        rows = await played(session, 60)
        later = session.set_prompt("the third prompt", frame=150)
        await later
        await saved(session)
        await quiet(two)
        held_to, held = session.playback.received_to, session.playback.rows(0, session.playback.received_to)
        two.lead_to(1)
        rows += await played(session, 200)
        assert (session.stats.resumes, session.reopenings) == (1, ())
        assert two.servers[1].engine.num_sessions == 1
        rows = list(np.array(rows))
        assert [row[FRAME] for row in rows] == list(range(260)), "frame numbers continue"
        assert np.array_equal(np.array(rows[:held_to]), held), "held frames have not changed"
        assert rows[149][PROMPT] == len("second one"), "the prompts are the same"
        assert rows[151][PROMPT] == len("the third prompt")
        assert rows[-1][PLAN] > held[-1][PLAN], "plan numbers continue"
        again = await session.set_prompt("and one more prompt")
        assert again.effective_frame is not None
        await until_true(lambda: not two.servers[0].engine.num_sessions)  # the first server has given up the session
        await session.close()


async def test_unanswered_events_are_answered_once_by_the_other_server(tmp_path: Path) -> None:
    async with pair(tmp_path) as two:
        session = await two.client.open("first", options=OPTIONS)
        await played(session, 60)
        await saved(session)
        await quiet(two)
        two.proxy.is_silent = True
        edits = [session.set_prompt("x" * length) for length in (5, 6, 7)]
        waypoint = session.add_waypoint(1, 2, frame=300)
        two.lead_to(1)
        two.proxy.is_silent = False
        for edit in (*edits, waypoint):
            await edit
        rows = await played(session, 150)
        assert session.reopenings == ()
        assert rows[-1][PROMPT] == 7


async def test_session_moves_back_and_forth_between_two_servers(tmp_path: Path) -> None:
    async with pair(tmp_path) as two:
        session = await two.client.open("first", options=OPTIONS)
        frames = [row[FRAME] for row in await played(session, 60)]
        for index in (1, 0, 1, 0):
            await saved(session)
            await quiet(two)
            two.lead_to(index)
            frames += [row[FRAME] for row in await played(session, 60)]
            await session.set_prompt(f"on server {index}")
        assert frames == list(range(300))
        assert (session.stats.resumes, session.reopenings) == (4, ())
        await until_true(lambda: not two.servers[1].engine.num_sessions)
        assert two.servers[0].engine.num_sessions == 1


async def test_session_without_a_snapshot_is_reopened_with_its_committed_frames(tmp_path: Path) -> None:
    async with pair(tmp_path) as two:
        session = await two.client.open("first", options=OPTIONS)
        await played(session, 60)
        await saved(session)
        told: list[bool] = []
        session.on_durability = told.append
        two.stores[0].is_broken = True
        await session.set_prompt("second one")  # still accepted
        await until_true(lambda: not session.is_durable)
        assert told == [False]
        rows = await played(session, 60)
        held = session.playback.rows(60, session.playback.committed_to)
        two.lead_to(1)
        rows += await played(session, 150)
        assert len(session.reopenings) == 1
        assert "SNAPSHOT_UNUSABLE" in session.reopenings[0].reason or "NOT_SAVED" in session.reopenings[0].reason
        assert np.array_equal(np.array(rows[: len(held)]), held)
        assert rows[-1][PROMPT] == len("second one"), "no acknowledged event is lost"
        for server in two.servers:
            server.runner.breaches = [each for each in server.runner.breaches if "history" not in each]


async def test_recovered_store_is_reported_and_used_again(tmp_path: Path) -> None:
    async with pair(tmp_path) as two:
        session = await two.client.open("first", options=OPTIONS)
        await played(session, 20)
        await saved(session)
        told: list[bool] = []
        session.on_durability = told.append
        two.stores[0].is_broken = True
        await session.set_prompt("second one")
        await until_true(lambda: told == [False])
        two.stores[0].is_broken = False
        await until_true(lambda: told == [False, True])
        await saved(session)
        await quiet(two)
        two.lead_to(1)
        await played(session, 100)
        assert (session.stats.resumes, session.reopenings) == (1, ())


async def test_resume_waits_for_a_store_that_is_unavailable_for_a_moment(tmp_path: Path) -> None:
    async with pair(tmp_path) as two:
        session = await two.client.open("first", options=OPTIONS)
        await saved(session)
        await quiet(two)
        two.stores[1].is_broken = True
        two.lead_to(1)
        await until_true(lambda: two.stores[1].num_failed > 1)
        two.stores[1].is_broken = False
        await played(session, 100)
        assert (session.stats.resumes, session.reopenings) == (1, ())


async def test_draining_server_leaves_its_sessions_to_the_other(tmp_path: Path) -> None:
    async with pair(tmp_path) as two:
        sessions = [await two.client.open("first", options=OPTIONS) for _ in range(3)]
        for session in sessions:
            await played(session, 50)
            await saved(session)
        await quiet(two)
        two.proxy.behind = two.servers[1].address
        two.servers[0].service.goodbye(1.0)
        two.servers[0].service.close_all()
        for session in sessions:
            frames = [row[FRAME] for row in await played(session, 100)]
            assert frames == list(range(50, 150))
            assert (session.stats.resumes, session.reopenings) == (1, ())


async def test_clients_that_are_sent_away_resume_on_the_other_server(tmp_path: Path) -> None:
    """As when a server loses its last engine: there is no grace, and the server itself stays."""
    async with pair(tmp_path) as two:
        session = await two.client.open("first", options=OPTIONS)
        await played(session, 50)
        await saved(session)
        await quiet(two)
        two.proxy.behind = two.servers[1].address
        two.servers[0].service.send_away()
        assert [row[FRAME] for row in await played(session, 100)] == list(range(50, 150))
        assert (session.stats.resumes, session.reopenings) == (1, ())
        await until_true(lambda: not two.servers[0].engine.num_sessions)


async def test_server_that_sends_clients_away_names_another_server(tmp_path: Path) -> None:
    """Without a proxy: the client connects to the other address itself."""
    told = Told()
    others = OtherServers(told, clock=lambda: 0.0)  # so that what it knows does not expire
    store = tmp_path / "one.sqlite"
    first = LocalServer(facts=FACTS_AS_SERVED, snapshots=SharedStore(store, 60), other_servers=others)
    second = LocalServer(facts=FACTS_AS_SERVED, snapshots=SharedStore(store, 60))
    async with asyncio.timeout(LIMIT_S), first, second:
        told.others = [Replica("second", second.address, "", {first.model.model_id: 0.5})]
        await asyncio.to_thread(others.exchange)
        async with MotionClient(first.address, other_addresses=[second.address]) as client:
            session = await client.open("first", options=OPTIONS)
            await played(session, 50)
            await saved(session)
            first.service.send_away()
            assert [row[FRAME] for row in await played(session, 100)] == list(range(50, 150))
            assert (session.stats.resumes, session.reopenings) == (1, ())
            assert (first.service.num_streams, second.service.num_streams) == (0, 1)
            await session.close()


async def test_closed_session_is_removed_from_the_store(tmp_path: Path) -> None:
    async with pair(tmp_path) as two:
        session = await two.client.open("first", options=OPTIONS)
        await played(session, 20)
        await saved(session)
        (name,) = two.stores[0].names
        await session.close()
        # read, not taken: only the holder of a session can drop it, and taking it would change the holder
        await until_true(lambda: two.stores[1].read(name) is None)
