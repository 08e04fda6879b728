"""Sessions that end here and continue elsewhere: unanswered events stay unanswered, so that clients send them again."""

from __future__ import annotations

import asyncio

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Close, Closed, CloseReason, Code, Durable, Event, Open, Outcome, SessionKey
from motiongen_server.engine.types.refusals import session_closed
from motiongen_server.rpc.sessions.durability import Durability
from motiongen_server.rpc.sessions.entry import SessionEntry
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, WALK, Line
from tests.server.snapshots.test_writer import Store

KEY = SessionKey(1, HANDLE)
LOST = Closed(KEY, CloseReason.ENGINE_FAULT, Code.UNAVAILABLE, "the engine was lost", 0, 0)


@pytest.fixture
async def line() -> Line:
    """A stream with an open session, one event of which waits for the encoder, and one behind that."""
    line = Line(kept=KeptSessions(30.0))
    line.open()
    line.send(2, edit_prompts=WALK)
    line.send(3, set_play_state=PAUSE)
    return line


def entry_of(line: Line) -> SessionEntry:
    assert line.kept is not None
    entry = line.kept.find(next(each.opened.session_token for each in line.updates() if each.HasField("opened")))
    assert entry is not None
    return entry


def save(line: Line) -> None:
    """The session is in the store, and its client knows."""
    entry_of(line).durable = Durable(KEY, 1, is_kept=True)


def answered(line: Line) -> list[int]:
    return [update.outcome.event_seq for update in line.updates() if update.HasField("outcome")]


async def test_lost_engine_leaves_events_of_a_saved_session_unanswered(line: Line) -> None:
    save(line)
    line.stream.take(session_closed().outcome(KEY, 4), LOST)
    assert answered(line) == []
    assert line.updates()[-1].HasField("closed")
    assert line.updates()[-1].applied_seq == 1


@pytest.mark.parametrize("durable", [None, Durable(KEY, 1, is_kept=False)], ids=["never", "not any more"])
async def test_lost_engine_answers_every_event_of_a_session_that_is_not_saved(
    line: Line, durable: Durable | None
) -> None:
    entry_of(line).durable = durable
    line.stream.take(session_closed().outcome(KEY, 4), LOST)
    assert sorted(answered(line)) == [2, 3, 4]
    assert line.updates()[-1].applied_seq == 3


async def test_draining_saved_session_accepts_and_answers_nothing_more(line: Line) -> None:
    save(line)
    line.stream.close_all(CloseReason.DRAINED)
    line.send(4, set_play_state=PAUSE)
    line.prompts.go.set()
    line.stream.take(Closed(KEY, CloseReason.DRAINED, Code.OK, "", 0, 0))
    assert answered(line) == []
    assert line.engine.kinds()[0] is Open
    assert len(line.engine.events) == 2, "its Open and its Close"


async def test_saved_session_closed_by_its_client_gets_all_answers(line: Line) -> None:
    save(line)
    line.stream.close_all(CloseReason.CLIENT)
    line.stream.take(Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0))
    assert answered(line) == [2, 3]


async def test_lost_engine_leaves_events_unanswered_without_a_stream_too(line: Line) -> None:
    save(line)
    line.stream.lose()
    kept = line.kept
    assert kept is not None
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(session_closed().outcome(KEY, 4), LOST)
    assert len(entry_of(line).answers) == 0
    assert entry_of(line).applied_seq == 1


async def test_session_drained_while_its_client_is_away_answers_nothing_more(line: Line) -> None:
    """A client that returns before the server is gone would think the event done, although no record has it."""
    save(line)
    entry, kept = entry_of(line), line.kept
    assert kept is not None
    line.stream.lose()
    kept.close_parked(CloseReason.DRAINED)
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(Closed(KEY, CloseReason.DRAINED, Code.OK, "", 0, 0))
    again = Line(engine=line.engine, kept=kept, number=2)
    point = session_pb2.ResumePoint(attempt=1, answered_seq=1)
    again.send(1, open=session_pb2.OpenSession(resume_token=entry.token, resume_point=point))
    assert answered(again) == []
    assert (again.updates()[-1].closed.reason, again.updates()[-1].applied_seq) == (CloseReason.DRAINED, 1)


async def test_session_taken_by_another_server_answers_nothing_more(line: Line) -> None:
    """Its client may come back here if the other server's answer was lost."""
    durability = Durability(Store(), asyncio.get_running_loop(), lambda _: None)
    entry = entry_of(line)
    durability.adopt(entry)
    lease = entry.lease
    assert lease is not None
    durability.fenced([lease])
    line.send(4, set_play_state=PAUSE)
    line.prompts.go.set()
    for _ in range(10):
        await asyncio.sleep(0)
    line.stream.take(Closed(KEY, CloseReason.TAKEN_OVER, Code.OK, "", 0, 0))
    assert answered(line) == []
    update = line.updates()[-1]
    assert (update.closed.reason, update.applied_seq) == (CloseReason.TAKEN_OVER, 1)
    assert (update.closed.code, update.closed.message) == (
        Code.UNAVAILABLE,
        "another server has taken over the session; resume it there",
    )
    assert len(line.engine.events) == 2, "its Open and its Close"
    await asyncio.to_thread(durability.close)


@pytest.mark.parametrize("is_away", [False, True])
@pytest.mark.parametrize("reason", ["ENGINE_RESTARTING", "SESSION_NOT_OPEN"])
async def test_events_sent_to_an_engine_lost_unnoticed_stay_unanswered(line: Line, reason: str, is_away: bool) -> None:
    save(line)
    entry, kept = entry_of(line), line.kept
    assert kept is not None

    def lost(event: Event) -> Outcome:
        return Outcome(KEY, event.event_seq, Code.UNAVAILABLE, reason=reason)

    line.engine.submit = lost  # type: ignore[method-assign]
    if is_away:
        line.stream.lose()
    line.prompts.go.set()
    for _ in range(10):
        await asyncio.sleep(0)
    assert (len(entry.waiting), entry.applied_seq) == (0, 1)
    (kept.carrier_of(KEY) or line.stream).take(LOST)
    assert answered(line) == []
    assert (entry.closed, entry.applied_seq, len(entry.answers)) == (LOST, 1, 0)


async def test_session_that_is_closed_with_its_stream_frees_its_place_before_the_engine_has_ended_it() -> None:
    """Its client may be back at once, and its quota must have room for the next session."""
    line = Line(kept=KeptSessions(0.0))
    line.open()
    assert line.stream.peer.num_sessions == 1
    line.stream.lose()
    assert line.engine.kinds() == [Open, Close]
    assert line.stream.peer.num_sessions == 0
