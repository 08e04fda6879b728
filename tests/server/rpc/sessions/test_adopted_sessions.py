"""Sessions that were taken over from another server, once this one serves them: theirs is what any session has."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from motiongen_server.engine.types import Close, Closed, CloseReason, Code, Open, Outcome, Resumed
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.snapshots import writer
from motiongen_server.snapshots.record import write_record
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Lease, Renewal
from tests.server.rpc.sessions.test_taking_over import RECORD, TOKEN, of_model, resuming
from tests.server.rpc.streams.test_event_order import WALK, Line
from tests.waiting import until_true

NAME = lease_of(TOKEN).name
KEEP_S = 60.0


@dataclass
class Adopting:
    """A client's line to a server, and the store with a session that another had. now_s: by the store's clock."""

    line: Line
    store: SqliteStore
    durability: Durability
    now_s: list[float]

    async def adopt(self) -> None:
        """Resume the session, until its engine is given it."""
        self.line.send(1, open=resuming(9))
        await until_true(lambda: bool(self.line.engine.events))
        assert self.line.engine.kinds() == [Open]


@pytest.fixture
async def adopting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Adopting]:
    monkeypatch.setattr(writer, "RENEW_EVERY_S", 0.02)
    now_s = [1000.0]
    store = SqliteStore(tmp_path / "store.sqlite", KEEP_S, lambda: now_s[0])
    store.save([(lease_of(TOKEN), write_record(RECORD))])
    durability = Durability(store, asyncio.get_running_loop(), lambda _: None)
    line = Line(catalog=of_model("fake").default.catalog, kept=KeptSessions(30.0, durability=durability))
    line.stream.peer.tenant = RECORD.tenant
    yield Adopting(line, store, durability, now_s)
    await asyncio.to_thread(durability.close)


async def test_one_that_stands_still_keeps_its_record(adopting: Adopting) -> None:
    """Nothing is saved of it then, and what nobody renews expires."""
    await adopting.adopt()
    store = adopting.store
    for _ in range(3):
        adopting.now_s[0] += KEEP_S / 2
        await until_true(lambda: expires_at(store) == adopting.now_s[0] + KEEP_S)


def expires_at(store: SqliteStore) -> float:
    ((when,),) = store.connection().execute("SELECT expires_at FROM sessions").fetchall()
    return float(when)


async def test_one_that_stands_still_ends_once_another_server_has_taken_it(adopting: Adopting) -> None:
    await adopting.adopt()
    assert adopting.store.take(Lease(NAME, 2), "a third server") is not None
    await until_true(lambda: len(adopting.line.engine.events) == 2)
    end = adopting.line.engine.events[1]
    assert isinstance(end, Close)
    assert end.reason is CloseReason.TAKEN_OVER


async def test_nothing_is_left_of_one_that_its_engine_refuses_after_its_line_was_lost(adopting: Adopting) -> None:
    """Its engine knows no session to close, so its place and its record would be held for good."""
    line, durability = adopting.line, adopting.durability
    kept, peer = line.stream._kept, line.stream.peer
    await adopting.adopt()
    key = line.engine.events[0].session
    line.stream.lose()
    assert (kept.num_parked, peer.num_sessions) == (1, 1)
    carrier = kept.carrier_of(key)
    assert carrier is not None
    carrier.take(Outcome(key, 1, Code.RESOURCE_EXHAUSTED, reason="OVERLOADED"))
    assert (kept.num_parked, kept.has_away, peer.num_sessions) == (0, False, 0)
    assert line.engine.kinds() == [Open], "there is nothing to be closed"
    assert not durability.writer._leases, "else its record would never expire"
    assert adopting.store.renew([Lease(NAME, 2)]) == [Renewal.KEPT], "its client may come again"


async def test_one_is_saved_from_the_beginning_and_its_client_knows(adopting: Adopting) -> None:
    """Nothing may be saved of it before it goes on elsewhere: what it was told here is then said again there."""
    line = adopting.line
    await adopting.adopt()
    key = line.engine.events[0].session
    line.stream.take(Resumed(key, 9, 60))
    (told,) = (update for update in line.updates() if update.HasField("durability"))
    assert (told.durability.is_kept, told.durable_seq) == (True, RECORD.taken_seq)
    line.send(RECORD.taken_seq + 1, edit_prompts=WALK)
    line.stream.close_all(CloseReason.DRAINED)
    line.stream.take(Closed(key, CloseReason.DRAINED, Code.OK, "", 0, 0))
    answers = [update.outcome.event_seq for update in line.updates() if update.HasField("outcome")]
    assert RECORD.taken_seq + 1 not in answers
