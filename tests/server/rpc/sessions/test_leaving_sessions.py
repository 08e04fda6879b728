"""Sessions that end here and go on elsewhere: what has not been answered is left so, for their clients to say again."""

from __future__ import annotations

import asyncio

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Closed, CloseReason, Code, Durable, Event, Open, Outcome, SessionKey
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
    """Of a session that is open, with one event that waits for the encoder and one behind it."""
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
    """The store has it, and its client knows."""
    entry_of(line).durable = Durable(KEY, 1, is_kept=True)


def answered(line: Line) -> list[int]:
    return [update.outcome.event_seq for update in line.updates() if update.HasField("outcome")]


async def test_a_lost_engine_answers_nothing_of_a_session_that_is_saved(line: Line) -> None:
    save(line)
    line.stream.take(session_closed().outcome(KEY, 4), LOST)
    assert answered(line) == []
    assert line.updates()[-1].HasField("closed")
    assert line.updates()[-1].applied_seq == 1


async def test_of_one_that_is_not_saved_everything_is_answered(line: Line) -> None:
    line.stream.take(session_closed().outcome(KEY, 4), LOST)
    assert sorted(answered(line)) == [2, 3, 4]
    assert line.updates()[-1].applied_seq == 3


async def test_one_that_drains_takes_nothing_more_and_answers_nothing_more(line: Line) -> None:
    save(line)
    line.stream.close_all(CloseReason.DRAINED)
    line.send(4, set_play_state=PAUSE)
    line.prompts.go.set()
    line.stream.take(Closed(KEY, CloseReason.DRAINED, Code.OK, "", 0, 0))
    assert answered(line) == []
    assert line.engine.kinds()[0] is Open
    assert len(line.engine.events) == 2, "its Open and its Close"


async def test_what_a_client_closes_itself_is_answered_though_it_is_saved(line: Line) -> None:
    save(line)
    line.stream.close_all(CloseReason.CLIENT)
    line.stream.take(Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0))
    assert answered(line) == [2, 3]


async def test_a_session_without_its_stream_is_left_the_same_way(line: Line) -> None:
    save(line)
    line.stream.lose()
    kept = line.kept
    assert kept is not None
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(session_closed().outcome(KEY, 4), LOST)
    assert len(entry_of(line).answers) == 0
    assert entry_of(line).applied_seq == 1


async def test_nor_is_anything_of_one_answered_that_drains_while_its_client_is_away(line: Line) -> None:
    """Who comes back for it here before the server is gone would take the event for done, which no record has."""
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


async def test_nor_of_one_that_another_server_has_taken(line: Line) -> None:
    """Its client may come back here, where the answer of the other server was lost."""
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
    assert (line.updates()[-1].closed.reason, line.updates()[-1].applied_seq) == (CloseReason.TAKEN_OVER, 1)
    assert len(line.engine.events) == 2, "its Open and its Close"
    await asyncio.to_thread(durability.close)


@pytest.mark.parametrize("is_away", [False, True])
@pytest.mark.parametrize("reason", ["ENGINE_RESTARTING", "SESSION_NOT_OPEN"])
async def test_nor_is_what_came_when_its_engine_was_lost_already_and_nobody_had_heard(
    line: Line, reason: str, is_away: bool
) -> None:
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
