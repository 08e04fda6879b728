"""Sessions taken over from another server, once this one serves them: they have what every session has."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Close,
    Closed,
    CloseReason,
    Code,
    Open,
    Outcome,
    Playhead,
    Resumed,
    SetPlayState,
)
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.entry import SessionEntry
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.sessions.taking_over import adopted
from motiongen_server.snapshots import writer
from motiongen_server.snapshots.record import write_record
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Lease, Renewal
from tests.server.rpc.sessions.test_taking_over import NOBODY, RECORD, TOKEN, of_model, resuming
from tests.server.rpc.streams.test_event_order import PAUSE, WALK, Line
from tests.server.snapshots.records import KEY
from tests.waiting import until_true

NAME = lease_of(TOKEN).name
KEEP_S = 60.0


@dataclass
class Adopting:
    """A client's stream to a server, and the store with another server's session. now_s: by the store's clock."""

    line: Line
    store: SqliteStore
    durability: Durability
    now_s: list[float]

    async def adopt(self) -> None:
        """Resumes the session, and returns once the engine has been given it."""
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


async def test_record_of_an_idle_adopted_session_is_renewed(adopting: Adopting) -> None:
    """An idle session is not saved again, and a record that nobody renews expires."""
    await adopting.adopt()
    store = adopting.store
    for _ in range(3):
        adopting.now_s[0] += KEEP_S / 2
        await until_true(lambda: expires_at(store) == adopting.now_s[0] + KEEP_S)


def expires_at(store: SqliteStore) -> float:
    ((when,),) = store.connection().execute("SELECT expires_at FROM sessions").fetchall()
    return float(when)


async def test_idle_adopted_session_is_closed_once_another_server_has_taken_it(adopting: Adopting) -> None:
    await adopting.adopt()
    assert adopting.store.take(Lease(NAME, 2), "a third server") is not None
    await until_true(lambda: len(adopting.line.engine.events) == 2)
    end = adopting.line.engine.events[1]
    assert isinstance(end, Close)
    assert end.reason is CloseReason.TAKEN_OVER


async def test_resume_behind_another_on_its_handle_is_taken_over_with_its_events(adopting: Adopting) -> None:
    line, unknown = adopting.line, resuming(9)
    unknown.resume_token = "unknown.1"
    line.send(1, open=unknown)
    line.send(1, open=resuming(9))
    line.send(RECORD.taken_seq + 1, set_play_state=PAUSE)
    await until_true(lambda: len(line.engine.events) == 2)
    assert line.refusals() == [(1, "SESSION_NOT_KEPT")]
    assert line.engine.kinds() == [Open, SetPlayState]
    assert line.engine.events[1].event_seq == RECORD.taken_seq + 1
    await until_true(lambda: not line.stream.peer.waiting_bytes)


async def test_playhead_of_an_adopted_session_does_not_wait_behind_events_that_must_be_paid(adopting: Adopting) -> None:
    line = adopting.line
    line.stream.budget.charge(1e6, time.monotonic())
    line.send(1, open=resuming(9))
    line.send(RECORD.taken_seq + 1, set_play_state=PAUSE)
    await until_true(lambda: bool(line.engine.events))
    line.send(0, playhead=session_pb2.Playhead(frame=70))
    assert line.engine.kinds() == [Open, Playhead]
    line.stream.lose()


async def test_adoption_refused_by_the_engine_after_the_stream_was_lost_is_undone(adopting: Adopting) -> None:
    """The engine knows no such session to close, so its place and its record would be held for good."""
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
    assert line.engine.kinds() == [Open], "the engine has nothing to close"
    assert not durability.writer._leases, "otherwise its record would never expire"
    assert adopting.store.renew([Lease(NAME, 2)]) == [Renewal.KEPT], "its client may resume it again"


async def test_events_waiting_for_a_refused_adoption_are_answered_and_not_reused(
    adopting: Adopting,
) -> None:
    line = adopting.line
    await adopting.adopt()
    key = line.engine.events[0].session
    line.send(RECORD.taken_seq + 1, edit_prompts=WALK)
    line.stream.take(Outcome(key, 1, Code.RESOURCE_EXHAUSTED, reason="OVERLOADED"))
    assert line.refusals() == [(RECORD.taken_seq + 1, "SESSION_CLOSED"), (1, "OVERLOADED")]
    assert line.stream.peer.waiting_bytes == 0
    line.prompts.go.set()
    line.send(1, open=session_pb2.OpenSession())
    line.send(2, edit_prompts=WALK)
    for _ in range(10):
        await asyncio.sleep(0)
    assert [(event.session, event.event_seq) for event in line.engine.events[1:]] == [(key, 1), (key, 2)]


async def test_events_waiting_for_a_refused_adoption_are_freed_without_a_stream(adopting: Adopting) -> None:
    line = adopting.line
    await adopting.adopt()
    key = line.engine.events[0].session
    line.send(RECORD.taken_seq + 1, edit_prompts=WALK)
    line.stream.lose()
    carrier = line.stream._kept.carrier_of(key)
    assert carrier is not None
    carrier.take(Outcome(key, 1, Code.RESOURCE_EXHAUSTED, reason="OVERLOADED"))
    assert line.stream.peer.waiting_bytes == 0


async def test_adopted_session_is_reported_as_durable_from_the_start(adopting: Adopting) -> None:
    """It may move on before anything is saved here: its client then sends again what this server had answered."""
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


def adopt(opening: session_pb2.OpenSession) -> tuple[SessionEntry, Open]:
    """The session of the record, for a client that resumes it with this opening."""
    return adopted(
        RECORD,
        TOKEN,
        opening,
        KEY,
        models=of_model("fake"),
        peer=Peer(PeerLimits(), 0.0, "studio"),
        carrier=NOBODY,
        events_per_second=50.0,
        now=0.0,
    )


def test_adopted_session_knows_which_events_were_answered() -> None:
    """Of the record's five events, the fourth still waits for its plan."""
    entry, _ = adopt(resuming(9))
    assert (entry.last_seq, entry.applied_seq) == (5, 3)
    assert [entry.is_answered(seq) for seq in range(1, 7)] == [True, True, True, False, True, False]
    entry.note(Outcome(KEY, 4, Code.OK, 90))
    assert (entry.applied_seq, entry.answered) == (5, set())


@pytest.mark.parametrize(
    ("said", "playhead", "committed_to"),
    [
        ({}, 88, 88),
        ({"playhead": 0}, 0, 88),
        ({"playhead": 70, "committed_to": 75}, 70, 75),
        ({"committed_to": 0}, 88, 0),
    ],
)
def test_resume_without_playhead_or_committed_to_uses_next_frame(
    said: dict[str, int], playhead: int, committed_to: int
) -> None:
    point = session_pb2.ResumePoint(attempt=9, next_frame=88, plan=8, answered_seq=3, **said)  # type: ignore[arg-type]
    entry, event = adopt(session_pb2.OpenSession(resume_token=TOKEN, resume_point=point))
    asked = event.going_on
    assert asked is not None
    assert (asked.playhead, asked.committed_to) == (playhead, committed_to)
    assert (asked.attempt, asked.next_frame, asked.plan) == (9, 88, 8) == (entry.attempt, 88, 8)
    assert [answer.event_seq for answer in entry.answers] == [5], "the client has confirmed the others"


def test_adopted_session_keeps_its_warnings_level_news_and_coding() -> None:
    entry, event = adopt(resuming(9))
    assert (event.event_seq, event.spec.session, entry.key) == (1, KEY, KEY)
    assert entry.is_resuming, "nothing is sent before the engine continues it"
    assert entry.known_to_engine
    assert entry.warnings == RECORD.warnings
    assert entry.level == RECORD.level
    assert (entry.coding.scalar_type, entry.coding.outputs) == (RECORD.opened.scalar_type, RECORD.opened.outputs)
    assert [each.constraint_id for each, _ in entry.reached] == [each.constraint_id for each in RECORD.reached]
