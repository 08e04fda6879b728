"""Which tokens resume a session: the newest, and earlier ones while its client may not have the newest."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Closed,
    CloseReason,
    Code,
    Durable,
    Open,
    Resume,
    Resumed,
    SessionKey,
    SnapshotTaken,
)
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.entry import SessionEntry
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.sessions.taking_over import claimed
from motiongen_server.snapshots.record import read_record, write_record
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Held, Lease, Renewal
from motiongen_server.text.turns import Asker
from tests.server.rpc.sessions.test_taking_over import RECORD, of_model, resuming
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, Line
from tests.waiting import until_true

FIRST, SECOND, THIRD = (f"secret.{epoch}" for epoch in (1, 2, 3))
NAME = lease_of(FIRST).name
ENDLESS = f"secret.{'9' * 5000}"
"""More digits than Python turns into a number."""
KEY = SessionKey(1, HANDLE)


class Servers:
    """A server that adopts a session from the store, and another that may be asked for it at any moment."""

    def __init__(self, path: Path) -> None:
        loop = asyncio.get_running_loop()
        self.store = SqliteStore(path, 60.0)
        self.store.save([(lease_of(FIRST), write_record(RECORD))])
        self.one, self.other = (Durability(SqliteStore(path, 60.0), loop, lambda _: None) for _ in range(2))
        self.kept = KeptSessions(30.0, durability=self.one)
        self._attempt = RECORD.attempt

    def line(self, number: int = 1) -> Line:
        """A client's stream to the first server."""
        line = Line(of_model("fake").default.catalog, kept=self.kept, number=number)
        line.stream.peer.tenant = RECORD.tenant
        return line

    def resuming(self, token: str) -> session_pb2.OpenSession:
        """The opening of the client's next attempt to resume."""
        self._attempt += 1
        opening = resuming(self._attempt)
        opening.resume_token = token
        return opening

    async def ask_other(self, token: str) -> str:
        """What the other server answers to a client with that token: a new token, or the reason of its refusal."""
        peer = Peer(PeerLimits(), 0.0, RECORD.tenant)
        try:
            told, _ = await claimed(self.other, self.resuming(token), peer, of_model("fake"), Asker())
        except EventRefused as refusal:
            return refusal.reason
        return told

    async def adopted(self) -> Line:
        """The stream of a client that was sent the second token, and may not have received it."""
        line = self.line()
        line.send(1, open=self.resuming(FIRST))
        await until_true(lambda: bool(line.engine.events))
        line.stream.take(Resumed(KEY, self._attempt, 0))
        (update,) = (each for each in line.updates() if each.HasField("opened"))
        assert update.opened.session_token == SECOND
        return line

    async def saved(self, line: Line) -> None:
        """Has the engine take a snapshot, and waits until it is in the store."""
        before = self.store.read(NAME)
        line.stream.take(SnapshotTaken(KEY, RECORD.snapshot))
        await until_true(lambda: self.one.writer.lag_s == 0.0 and self.store.read(NAME) != before)

    async def close(self) -> None:
        for each in (self.one, self.other):
            await asyncio.to_thread(each.close)


@pytest.fixture
async def servers(tmp_path: Path) -> AsyncIterator[Servers]:
    servers = Servers(tmp_path / "store.sqlite")
    yield servers
    await servers.close()


@pytest.mark.parametrize("token", ["secret.0", SECOND, "secret.77", "secret.999999999999", ENDLESS])
async def test_token_that_was_never_issued_takes_nothing_over(servers: Servers, token: str) -> None:
    assert await servers.ask_other(token) == "SESSION_NOT_KEPT"
    assert servers.store.renew([lease_of(FIRST)]) == [Renewal.KEPT]


async def test_client_can_resume_however_many_answers_were_lost(servers: Servers) -> None:
    """The client still has the token that it came with, and comes with it again."""
    for epoch in range(2, 7):
        assert await servers.ask_other(FIRST) == f"secret.{epoch}"
    assert await servers.ask_other("secret.6") == "secret.7", "the client received that one"


async def test_previous_token_is_valid_until_the_client_uses_the_newest(servers: Servers) -> None:
    line = await servers.adopted()
    await servers.saved(line)
    assert await servers.ask_other(FIRST) == THIRD, "the client may not have received the second"


@pytest.mark.parametrize("says", ["an event", "its playhead"])
async def test_previous_token_is_invalid_once_the_client_was_heard_with_the_newest(servers: Servers, says: str) -> None:
    line = await servers.adopted()
    if says == "an event":
        line.send(RECORD.taken_seq + 1, set_play_state=PAUSE)
    else:
        line.send(0, playhead=session_pb2.Playhead(frame=50))
    await servers.saved(line)
    assert await servers.ask_other(FIRST) == "SESSION_NOT_KEPT"
    assert servers.store.renew([lease_of(SECOND)]) == [Renewal.KEPT], "the server that has the session keeps it"
    assert await servers.ask_other(SECOND) == THIRD


async def test_previous_token_is_valid_after_events_that_were_sent_with_the_resume(servers: Servers) -> None:
    """They show nothing: the client sent them before it could have the newest token."""
    line = servers.line()
    line.send(1, open=servers.resuming(FIRST))
    line.send(RECORD.taken_seq + 1, set_play_state=PAUSE)
    await until_true(lambda: len(line.engine.events) == 2)
    line.stream.take(Resumed(KEY, servers._attempt, 0))
    await servers.saved(line)
    assert await servers.ask_other(FIRST) == THIRD


async def test_previous_token_is_invalid_once_the_newest_was_used_to_resume(servers: Servers) -> None:
    line = await servers.adopted()
    assert await servers.ask_other(SECOND) == THIRD
    line = servers.line(2)
    line.send(1, open=servers.resuming(THIRD))
    await until_true(lambda: bool(line.engine.events))
    assert line.refusals() == []
    fourth = lease_of("secret.4")
    held = servers.store.read(NAME)
    assert held is not None
    assert held.epoch == 4
    entry = servers.kept.find("secret.4")
    assert isinstance(entry, SessionEntry)
    line.stream.take(SnapshotTaken(entry.key, RECORD.snapshot))
    await until_true(lambda: servers.store.read(NAME) != held)
    assert servers.store.renew([fourth]) == [Renewal.KEPT]
    assert await servers.ask_other(SECOND) == "SESSION_NOT_KEPT"


@pytest.mark.parametrize("token", [FIRST, "secret.77", ENDLESS])
async def test_invalid_tokens_are_refused_by_the_server_that_parks_the_session_too(
    servers: Servers, token: str
) -> None:
    line = await servers.adopted()
    line.send(0, playhead=session_pb2.Playhead(frame=50))
    await servers.saved(line)
    line.stream.lose()
    assert servers.kept.num_parked == 1
    again = servers.line(2)
    again.send(1, open=servers.resuming(token))
    await until_true(again.refusals)
    assert again.refusals() == [(1, "SESSION_NOT_KEPT")]
    assert servers.store.renew([lease_of(SECOND)]) == [Renewal.KEPT]
    again.send(1, open=servers.resuming(SECOND))
    assert again.stream.num_sessions == 1, "the server still has the session"
    assert Resume in line.engine.kinds()


async def test_previous_token_resumes_an_adopted_session_without_the_store(
    servers: Servers,
) -> None:
    """If the server took it over from itself, the session would exist and count twice until the store had answered."""
    line = await servers.adopted()
    line.stream.lose()
    for number in (2, 3):
        again = servers.line(number)
        again.send(1, open=servers.resuming(FIRST))
        assert again.stream.num_sessions == 1, "the store is not asked"
        again.stream.take(Resumed(KEY, servers._attempt, 0))
        (told,) = (update.opened.session_token for update in again.updates() if update.HasField("opened"))
        assert told == SECOND
        assert again.stream.peer.num_sessions == 0, "the session has its place already"
        again.stream.lose()
    assert line.engine.kinds() == [Open, Resume, Resume]
    assert servers.store.renew([lease_of(SECOND)]) == [Renewal.KEPT]


@pytest.mark.parametrize("how", ["is being closed", "has ended"])
async def test_previous_token_does_not_resume_a_session_that_ends_here(servers: Servers, how: str) -> None:
    """It would be told of the end, but can continue from the store."""
    line = await servers.adopted()
    assert servers.kept.resumed_by(FIRST) is not None
    if how == "is being closed":
        line.stream.close_all(CloseReason.DRAINED)
    else:
        line.stream.lose()
        carrier = servers.kept.carrier_of(KEY)
        assert carrier is not None
        carrier.take(Closed(KEY, CloseReason.ENGINE_FAULT, Code.UNAVAILABLE, "lost", 0, 0))
    assert servers.kept.find(SECOND) is not None
    assert servers.kept.resumed_by(FIRST) is None


async def test_end_of_a_session_that_came_back_to_its_server_leaves_the_new_one_its_tokens(servers: Servers) -> None:
    """Its server may find out only after the client has come back that another had it meanwhile."""
    await servers.adopted()
    assert await servers.ask_other(SECOND) == THIRD
    line = servers.line(2)
    line.send(1, open=servers.resuming(THIRD))
    await until_true(lambda: bool(line.engine.events))
    servers.one.fenced([lease_of(SECOND)])
    assert servers.kept.resumed_by(THIRD) is servers.kept.find("secret.4") is not None


async def test_session_adopted_while_the_store_is_in_doubt_does_not_count_as_saved(servers: Servers) -> None:
    servers.one.writer._doubt("the disk is slow")
    await servers.adopted()
    entry = servers.kept.find(SECOND)
    assert entry is not None
    assert entry.durable == Durable(KEY, RECORD.taken_seq, is_kept=False)


async def test_take_over_reads_again_if_another_took_the_session_in_between(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An earlier attempt of the same client, which it has given up, may be processed meanwhile."""
    servers, num_taken = Servers(tmp_path / "store.sqlite"), 0
    take = SqliteStore.take

    def late(store: SqliteStore, lease: Lease, holder: str) -> Held | None:
        nonlocal num_taken
        num_taken += 1
        if num_taken == 1:
            take(store, lease, "the attempt before")
        return take(store, lease, holder)

    monkeypatch.setattr(SqliteStore, "take", late)
    assert await servers.ask_other(FIRST) == THIRD
    assert num_taken == 2
    held = servers.store.read(NAME)
    assert held is not None
    assert read_record(held.data).taken_seq == RECORD.taken_seq
    await servers.close()
