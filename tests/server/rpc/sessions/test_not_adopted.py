"""Sessions of other servers that are requested and then not continued here: who is told, and what is left."""

from __future__ import annotations

import asyncio
from pathlib import Path

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Code, Event, Open, Outcome
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.event_path import MAX_WAITING_EVENTS
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.snapshots.record import write_record
from motiongen_server.snapshots.store import Renewal
from tests.server.rpc.sessions.test_taking_over import RECORD, TOKEN, SlowStore, of_model, resuming
from tests.server.rpc.streams.test_event_order import PAUSE, Line
from tests.waiting import until_true


def asking(tmp_path: Path) -> tuple[Line, SlowStore, Durability]:
    """A stream, and a store with another server's session that answers once its gate is open."""
    store = SlowStore(tmp_path / "store.sqlite")
    store.save([(lease_of(TOKEN), write_record(RECORD))])
    durability = Durability(store, asyncio.get_running_loop(), lambda _: None)
    line = Line(catalog=of_model("fake").default.catalog, kept=KeptSessions(30.0, durability=durability))
    line.stream.peer.tenant = RECORD.tenant
    return line, store, durability


async def test_session_whose_client_left_during_the_take_over_is_not_adopted(tmp_path: Path) -> None:
    line, store, durability = asking(tmp_path)
    line.send(1, open=resuming(9))
    line.stream.lose()
    store.gate.set()
    await until_true(lambda: not line.stream.peer.waiting_bytes)
    assert (line.engine.events, line.stream.num_sessions, line.stream.peer.num_sessions) == ([], 0, 0)
    assert not durability.writer._leases, "the lease is not held: its client will resume the session again"
    await asyncio.to_thread(durability.close)


async def test_resume_that_no_engine_accepts_is_refused_and_frees_the_handle(tmp_path: Path) -> None:
    line, store, durability = asking(tmp_path)
    store.gate.set()
    asked: list[Event] = []

    def full(event: Event) -> Outcome:
        asked.append(event)
        return Outcome(event.session, event.event_seq, Code.RESOURCE_EXHAUSTED, reason="OVERLOADED")

    line.engine.submit = full  # type: ignore[method-assign]
    line.send(1, open=resuming(9))
    await until_true(lambda: bool(line.refusals()))
    assert line.refusals() == [(1, "OVERLOADED")]
    assert [type(event) for event in asked] == [Open]
    assert (line.stream.num_sessions, line.stream.peer.num_sessions, line.kept and line.kept.has_away) == (0, 0, False)
    await asyncio.to_thread(durability.close)


async def test_events_wait_for_the_take_over_but_playheads_are_dropped(tmp_path: Path) -> None:
    line, store, durability = asking(tmp_path)
    line.send(1, open=resuming(9))
    waiting = line.stream.peer.waiting_bytes
    line.send(0, playhead=session_pb2.Playhead(frame=70))
    assert line.stream.peer.waiting_bytes == waiting
    line.send(RECORD.taken_seq + 1, set_play_state=PAUSE)
    assert line.stream.peer.waiting_bytes > waiting
    store.gate.set()
    await until_true(lambda: len(line.engine.events) == 2)
    line.send(0, playhead=session_pb2.Playhead(frame=70))
    assert [event.event_seq for event in line.engine.events] == [1, RECORD.taken_seq + 1, 0]
    await until_true(lambda: not line.stream.peer.waiting_bytes)
    await asyncio.to_thread(durability.close)


async def test_server_that_is_going_away_takes_no_session_over(tmp_path: Path) -> None:
    line, store, durability = asking(tmp_path)
    store.gate.set()
    line.stream.accepts_opens = False
    line.send(1, open=resuming(9))
    await until_true(lambda: bool(line.refusals() or line.engine.events))
    assert line.refusals() == [(1, "DRAINING")]
    assert store.renew([lease_of(TOKEN)]) == [Renewal.KEPT], "the server that has it keeps it"
    await asyncio.to_thread(durability.close)


async def test_no_more_events_wait_for_a_take_over_than_for_prompts(tmp_path: Path) -> None:
    line, store, durability = asking(tmp_path)
    line.send(1, open=resuming(9))
    first = RECORD.taken_seq + 1
    for event_seq in range(first, first + MAX_WAITING_EVENTS + 1):
        line.send(event_seq, set_play_state=PAUSE)
    assert line.refusals() == [(first + MAX_WAITING_EVENTS, "TOO_MANY_PENDING_EVENTS")]
    store.gate.set()
    await until_true(lambda: not line.stream.peer.waiting_bytes)
    await asyncio.to_thread(durability.close)


async def test_session_is_not_moved_to_a_stream_that_was_lost_while_its_resume_waited(tmp_path: Path) -> None:
    """It would be kept for ever, since its grace period would have ended with the move."""
    line, store, durability = asking(tmp_path)
    assert line.kept is not None
    other = Line(line.catalog, kept=line.kept, number=2)
    other.stream.peer.tenant = RECORD.tenant
    other.open()
    token = next(update.opened.session_token for update in other.updates() if update.HasField("opened"))
    other.stream.lose()
    line.send(1, open=resuming(9))
    point = session_pb2.ResumePoint(attempt=1)
    line.send(1, open=session_pb2.OpenSession(resume_token=token, resume_point=point))
    line.stream.lose()
    store.gate.set()
    await until_true(lambda: not line.stream.peer.waiting_bytes)
    assert (line.kept.num_parked, line.stream.num_sessions) == (1, 0)
    await asyncio.to_thread(durability.close)
