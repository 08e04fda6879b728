"""Resumes for which the store must be asked: they take turns, are paid for beforehand, and may be told to retry."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.budgets.loop_time import REFUSED_TIMES, Clocks, LoopTime, Work
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.stream_budget import RESUME_COST, StreamBudget
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.sessions import store_turns
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.sessions.store_turns import ASKED_AGAIN_S, AWAY_S, StoreAway, StoreTurns
from motiongen_server.rpc.sessions.taking_over import claimed
from motiongen_server.snapshots.record import write_record
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Held, Lease, StoreFailed
from motiongen_server.snapshots.taker import TAKERS
from motiongen_server.text.turns import Asker
from tests.server.rpc.budgets.test_loop_time import Ticks
from tests.server.rpc.sessions.test_taking_over import RECORD, TOKEN, of_model, resuming
from tests.server.rpc.streams.test_event_order import Line
from tests.waiting import LIMIT_S, until_true


class Store(SqliteStore):
    """Notes which names it is asked for. gate: it answers once that is open; is_broken: it fails; is_full: it can only
    be read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, 60.0)
        self.gate = threading.Event()
        self.is_broken = self.is_full = False
        self.asked: list[str] = []

    def read(self, name: str) -> Held | None:
        self.asked.append(name)
        self.gate.wait(LIMIT_S)
        if self.is_broken:
            raise StoreFailed("the disk is full")
        return super().read(name)

    def take(self, lease: Lease, holder: str) -> Held | None:
        if self.is_full:
            raise StoreFailed("the disk is full")
        return super().take(lease, holder)


class Server:
    """What streams of several peers share."""

    def __init__(self, path: Path) -> None:
        self.store = Store(path)
        self.durability = Durability(self.store, asyncio.get_running_loop(), lambda _: None)
        self._kept = KeptSessions(30.0, durability=self.durability)
        self._num_lines = 0

    def line(self, peer: str) -> Line:
        """The stream of a client of that peer, with the tenant of the session that tests save in the store."""
        self._num_lines += 1
        line = Line(of_model("fake").default.catalog, kept=self._kept, number=self._num_lines)
        line.stream.peer.name, line.stream.peer.tenant = peer, RECORD.tenant
        return line


@pytest.fixture
async def server(tmp_path: Path) -> AsyncIterator[Server]:
    server = Server(tmp_path / "store.sqlite")
    yield server
    server.store.gate.set()
    await asyncio.to_thread(server.durability.close)


def resume(line: Line, handle: int, token: str) -> None:
    opening = resuming(9)
    opening.resume_token = token
    line.stream.receive(session_pb2.SessionEvent(session=handle, event_seq=1, open=opening), time.monotonic())


async def test_resumes_with_invented_tokens_take_turns_with_other_peers(server: Server) -> None:
    """If the first asked came first, hundreds of invented tokens would keep all others waiting."""
    flood, other = server.line("flood"), server.line("other")
    for handle in range(1, 101):
        resume(flood, handle, f"made-up-{handle}.1")
    resume(other, 1, "of-a-client.1")
    server.store.gate.set()
    await until_true(lambda: len(flood.refusals()) == 100)
    assert server.store.asked.index(lease_of("of-a-client.1").name) < 2 * TAKERS


async def test_peer_with_most_waiting_resumes_retries_when_too_many_wait(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_turns, "MOST_ASKING", TAKERS + 3)
    server = Server(tmp_path / "store.sqlite")
    flood, other = server.line("flood"), server.line("other")
    for handle in range(1, TAKERS + 4):
        resume(flood, handle, f"made-up-{handle}.1")
    resume(other, 1, "of-a-client.1")
    await until_true(flood.refusals)
    server.store.gate.set()
    await until_true(lambda: len(flood.refusals()) == TAKERS + 3 and other.refusals())
    assert sorted(reason for _, reason in flood.refusals()) == ["SESSION_NOT_KEPT" for _ in range(TAKERS + 2)] + [
        "SESSION_STORE_BUSY"
    ]
    assert other.refusals() == [(1, "SESSION_NOT_KEPT")]
    (busy,) = (each.outcome for each in flood.updates() if each.outcome.reason == "SESSION_STORE_BUSY")
    assert busy.HasField("retry_after")
    await asyncio.to_thread(server.durability.close)


@pytest.mark.parametrize("how", ["it fails", "it does not answer"])
async def test_clients_are_told_to_retry_while_the_store_does_not_answer(
    server: Server, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If told that the session is not kept, they would give it up for good."""
    server.store.save([(lease_of(TOKEN), write_record(RECORD))])
    line = server.line("studio")
    if how == "it fails":
        server.store.is_broken = True
        server.store.gate.set()
    else:
        monkeypatch.setattr(store_turns, "TAKE_S", 0.0)
    resume(line, 7, TOKEN)
    await until_true(line.refusals)
    assert line.refusals() == [(1, "SESSION_STORE_UNAVAILABLE")]
    assert line.heard[0].outcome.HasField("retry_after")

    server.store.is_broken = False
    server.store.gate.set()
    monkeypatch.undo()
    resume(line, 7, TOKEN)
    await until_true(lambda: bool(line.engine.events))
    assert len(line.refusals()) == 1


async def test_store_that_keeps_failing_counts_as_away_after_a_while() -> None:
    now = [0.0]
    turns = StoreTurns(lambda: now[0])

    async def fail() -> None:
        raise StoreFailed("it is gone")

    async def asked() -> str:
        try:
            await turns.take(Asker(), fail)
        except EventRefused as refusal:
            return refusal.reason
        except StoreAway:
            return "away"
        return ""

    async def asked_until(end_s: float) -> set[str]:
        heard = set()
        while now[0] <= end_s:
            heard.add(await asked())
            now[0] += 1.0
        return heard

    assert await asked_until(AWAY_S) == {"SESSION_STORE_UNAVAILABLE"}
    assert await asked() == "away"
    turns.note_answer()
    assert await asked() == "SESSION_STORE_UNAVAILABLE", "it has answered another client since"
    now[0] += AWAY_S + ASKED_AGAIN_S
    assert await asked() == "SESSION_STORE_UNAVAILABLE", "nobody has asked in between"


async def test_resumes_are_refused_for_good_if_the_store_stays_read_only(server: Server) -> None:
    """For example a full one: no session can be taken from it, so a client would wait for its own for ever."""
    server.store.save([(lease_of(TOKEN), write_record(RECORD))])
    server.store.gate.set()
    server.store.is_full = True
    now = [0.0]
    server.durability._turns = StoreTurns(lambda: now[0])
    peer, reasons = Peer(PeerLimits(), 0.0, RECORD.tenant), []
    while now[0] <= AWAY_S + 1.0:
        with pytest.raises(EventRefused) as refused:
            await claimed(server.durability, resuming(9), peer, of_model("fake"), Asker())
        reasons.append(refused.value.reason)
        now[0] += 1.0
    assert reasons[:-1] == ["SESSION_STORE_UNAVAILABLE"] * (len(reasons) - 1)
    assert reasons[-1] == "SESSION_NOT_KEPT"


async def test_resume_is_charged_once_and_in_advance_also_if_it_succeeds(server: Server) -> None:
    """Otherwise, with a slow store, a client could ask for thousands before it paid for the first. If it succeeds, a
    look-ahead of frames is sent again, as for a session of this server.
    """
    server.store.save([(lease_of(TOKEN), write_record(RECORD))])
    line = server.line("studio")
    now = time.monotonic()
    # The budget is not replenished during the test.
    line.stream.budget = StreamBudget(1e-3, Peer(PeerLimits(), now), now)

    def num_owed() -> int:
        return round(1e-3 * line.stream.owed_s(time.monotonic()))

    resume(line, 7, TOKEN)
    assert num_owed() == RESUME_COST
    server.store.gate.set()
    await until_true(lambda: bool(line.engine.events))
    assert num_owed() == RESUME_COST
    resume(line, 8, "made-up.1")
    await until_true(line.refusals)
    assert num_owed() == 2 * RESUME_COST


async def test_loop_time_of_a_refused_resume_is_charged_several_times(server: Server) -> None:
    line, ticks = server.line("studio"), Ticks()
    loop, charged = LoopTime(clocks=Clocks(ticks, ticks)), list[float]()
    line.stream.work = Work(loop, charged.append)
    resume(line, 7, "made-up.1")
    assert loop.taken_s == 0.0, "the time for the message is measured by its reader"
    server.store.gate.set()
    await until_true(lambda: not line.stream.peer.waiting_bytes)
    asked_s, answered_s = charged
    assert asked_s > 0, "the time until the store is asked"
    assert answered_s == pytest.approx(REFUSED_TIMES * (loop.taken_s - asked_s)), "the time from its answer on"
    assert line.refusals() == [(1, "SESSION_NOT_KEPT")]


async def test_resume_without_a_turn_in_time_does_not_count_as_a_store_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    now, gate = [0.0], asyncio.Event()
    turns = StoreTurns(lambda: now[0])
    asking = [asyncio.create_task(turns.take(Asker("others"), gate.wait)) for _ in range(TAKERS)]
    await asyncio.sleep(0)
    monkeypatch.setattr(store_turns, "TAKE_S", 0.0)
    for _ in range(2):
        with pytest.raises(EventRefused) as refused:
            await turns.take(Asker("client"), gate.wait)
        assert refused.value.reason == "SESSION_STORE_BUSY"
        now[0] += ASKED_AGAIN_S - 1.0
    monkeypatch.undo()
    gate.set()
    assert await asyncio.gather(*asking) == [True] * TAKERS
    now[0] = AWAY_S + 1.0

    async def fail() -> None:
        raise StoreFailed("it is gone")

    with pytest.raises(EventRefused) as refused:
        await turns.take(Asker("client"), fail)
    assert refused.value.reason == "SESSION_STORE_UNAVAILABLE", "this is the first failure"
