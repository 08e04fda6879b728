"""What a session's record counts as taken: every answered event, and none that the engine may still lose."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Closed,
    CloseReason,
    Code,
    ConstraintReached,
    Durable,
    Outcome,
    SaveAgain,
    ServiceLevel,
    ServiceTier,
    SessionKey,
    SnapshotTaken,
    Warned,
)
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.entry import SessionEntry
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.snapshots.record import SessionRecord, read_record
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Lease
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, WALK, Line
from tests.server.snapshots.records import a_record
from tests.waiting import until_true

KEY = SessionKey(1, HANDLE)


@dataclass
class Saving:
    """A client's stream to a server that saves its session."""

    line: Line
    token: str
    store: SqliteStore
    durability: Durability
    counted: list[str]
    path: Path

    @property
    def entry(self) -> SessionEntry:
        entry = self.line.kept and self.line.kept.find(self.token)
        assert entry
        return entry

    async def record(self, last_seq: int) -> SessionRecord:
        """The record in the store after a snapshot of the engine, which has taken the events up to that number."""
        snapshot = replace(a_record().snapshot, last_seq=last_seq, unanswered=())
        self.line.stream.take(SnapshotTaken(KEY, snapshot))
        name = lease_of(self.token).name
        await until_true(lambda: self.store.read(name) is not None)
        held = self.store.read(name)
        assert held is not None
        return read_record(held.data)


@pytest.fixture
async def saving(tmp_path: Path) -> AsyncIterator[Saving]:
    store, counted = SqliteStore(tmp_path / "store.sqlite", 60.0), list[str]()
    durability = Durability(store, asyncio.get_running_loop(), counted.append)
    line = Line(kept=KeptSessions(30.0, durability=durability))
    line.open()
    (token,) = (each.opened.session_token for each in line.updates() if each.HasField("opened"))
    yield Saving(line, token, store, durability, counted, tmp_path / "store.sqlite")
    await asyncio.to_thread(durability.close)


async def test_events_waiting_for_the_encoder_do_not_count_as_taken(saving: Saving) -> None:
    saving.line.send(2, edit_prompts=WALK)
    saving.line.send(3, set_play_state=PAUSE)
    assert (await saving.record(1)).taken_seq == 1


async def test_event_refused_by_the_edge_counts_as_taken_but_a_later_pending_not(
    saving: Saving,
) -> None:
    saving.line.send(2, set_velocity=session_pb2.SetVelocity(x=float("nan")))
    assert [seq for seq, _ in saving.line.refusals()] == [2]
    saving.line.send(3, set_play_state=PAUSE)
    record = await saving.record(1)
    assert record.taken_seq == 2
    assert [answer.event_seq for answer in record.answers] == [2]


async def test_record_has_no_answers_to_events_after_the_last_taken(saving: Saving) -> None:
    saving.line.send(2, edit_prompts=WALK)
    saving.line.send(3, set_play_state=PAUSE)
    saving.line.stream.take(Outcome(KEY, 3, Code.OK))
    record = await saving.record(1)
    assert (record.taken_seq, record.answers) == (1, ())


async def test_record_has_what_a_client_that_resumes_elsewhere_is_told_and_the_last_attempt(saving: Saving) -> None:
    """Without the attempt, an older resume that was delayed could take the session from its client."""
    level = ServiceLevel(KEY, ServiceTier.FEWER_STEPS, 3)
    reached = ConstraintReached(KEY, 3, False, 5, 1, None, None, None)
    saving.line.stream.take(level, reached)
    saving.entry.attempt = 7
    record = await saving.record(1)
    assert (record.attempt, record.level, record.reached) == (7, level, (reached,))


async def test_client_is_told_of_each_change_of_durability_once(saving: Saving) -> None:
    await saving.record(1)
    entry = saving.entry
    assert entry.lease is not None
    lease, durability = entry.lease, saving.durability
    told: list[tuple[int, bool]] = []

    def new_of(act: Callable[[], None]) -> list[tuple[int, bool]]:
        act()
        updates = (each for each in saving.line.updates() if each.HasField("durability"))
        now = [(each.durable_seq, each.durability.is_kept) for each in updates]
        fresh, told[:] = now[len(told) :], now
        return fresh

    await until_true(lambda: entry.durable is not None)
    assert new_of(lambda: None) == [(1, True)]
    assert new_of(lambda: durability.written([(lease, 3)])) == [(3, True)]
    assert new_of(lambda: durability.written([(lease, 2)])) == [], "the number never decreases"
    assert new_of(lambda: durability.lost([lease])) == [(3, False)]
    assert new_of(lambda: durability.lost([lease])) == []
    assert new_of(lambda: durability.renewed([lease])) == [(3, True)]
    assert new_of(durability.failed) == [(3, False)]
    assert new_of(lambda: durability.written([(lease, 4)])) == [(4, True)]
    assert saving.counted.count("lost") == 1, "the second time, the loss was known already"


async def test_sessions_lost_by_the_store_are_saved_again_unless_they_are_closing(
    saving: Saving, monkeypatch: pytest.MonkeyPatch
) -> None:
    await saving.record(1)
    entry, durability = saving.entry, saving.durability
    lease = entry.lease
    assert lease is not None
    await until_true(lambda: entry.durable is not None)

    def asked_for(*leases: Lease) -> list[SessionKey]:
        saving.line.engine.events.clear()
        durability.gone(leases)
        return [event.session for event in saving.line.engine.events if isinstance(event, SaveAgain)]

    assert asked_for(lease, Lease("of nobody", 1)) == [KEY]
    assert entry.durable == Durable(KEY, 1, False), "until it is saved again"
    monkeypatch.setattr("motiongen_server.rpc.sessions.durability.MOST_SAVED_AGAIN", 1)
    assert asked_for(Lease("of nobody", 1), lease) == []
    assert asked_for(lease) == [KEY]
    entry.closing = True
    assert asked_for(lease) == []


@pytest.mark.parametrize(
    ("closed", "stays"),
    [
        (Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0), False),
        (Closed(KEY, CloseReason.IDLE, Code.OK, "", 0, 0), False),
        (Closed(KEY, CloseReason.DRAINED, Code.OK, "", 0, 0), True),
        (Closed(KEY, CloseReason.ENGINE_FAULT, Code.UNAVAILABLE, "", 0, 0), True),
    ],
    ids=lambda value: value.reason.name if isinstance(value, Closed) else "",
)
async def test_record_outlives_its_session_only_if_that_may_continue_elsewhere(
    saving: Saving, closed: Closed, stays: bool
) -> None:
    await saving.record(1)
    name = lease_of(saving.token).name
    saving.line.stream.take(closed)
    if not stays:
        await until_true(lambda: saving.store.read(name) is None)
    await asyncio.to_thread(saving.durability.close)
    again = SqliteStore(saving.path, 60.0)
    assert (again.read(name) is not None) is stays
    again.close()


async def test_warnings_are_sent_with_an_accepted_event_and_not_with_a_refusal(saving: Saving) -> None:
    warned = (Warned("FAST", "faster than it was trained for", "velocity"),)
    entry = saving.entry
    entry.warnings.update({2: warned, 3: warned})
    for event_seq, code, told in ((2, Code.OK, warned), (3, Code.NOT_FOUND, ()), (4, Code.OK, ())):
        said = entry.note(Outcome(KEY, event_seq, code))
        assert isinstance(said, Outcome)
        assert said.warnings == told
    assert entry.warnings == {}
