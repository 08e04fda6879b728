"""Which sessions a stream admits, and that one can always be closed."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Close, Closed, CloseReason, Code, Open, Opened, Outcome, SessionKey
from motiongen_server.replicas.hint import OtherServer
from motiongen_server.rpc.errors.events import model_failed
from motiongen_server.rpc.sessions.durability import Durability
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from tests.server.rpc.sessions.test_taking_over import SlowStore, resuming
from tests.server.rpc.streams.test_event_order import PAUSE, Line, make_catalog
from tests.waiting import until_true

MOST = 3


def ask(line: Line, handle: int, opening: session_pb2.OpenSession | None = None) -> None:
    event = session_pb2.SessionEvent(session=handle, event_seq=1, open=opening or session_pb2.OpenSession())
    line.stream.receive(event, time.monotonic())


def refused(line: Line) -> list[tuple[int, str]]:
    """The handle and the reason of each refusal."""
    told = [update for update in line.updates() if update.HasField("outcome")]
    return [(update.session, update.outcome.reason) for update in told]


async def test_sessions_of_a_stream_are_limited_and_an_ended_one_frees_its_place() -> None:
    line = Line(make_catalog(max_sessions_per_stream=MOST))
    for handle in range(1, MOST + 2):
        ask(line, handle)
    assert refused(line) == [(MOST + 1, "TOO_MANY_SESSIONS")]
    line.stream.take(Closed(SessionKey(1, 2), CloseReason.CLIENT, Code.OK, "", 0, 0))
    ask(line, MOST + 1)
    ask(line, MOST + 2)
    assert refused(line) == [(MOST + 1, "TOO_MANY_SESSIONS"), (MOST + 2, "TOO_MANY_SESSIONS")]


async def test_sessions_being_taken_over_count_against_the_stream_s_limit(tmp_path: Path) -> None:
    store = SlowStore(tmp_path / "store.sqlite")
    durability = Durability(store, asyncio.get_running_loop(), lambda _: None)
    line = Line(make_catalog(max_sessions_per_stream=MOST), kept=KeptSessions(30.0, durability=durability))
    ask(line, 1)
    for handle in (2, 3, 4):
        ask(line, handle, resuming(1))
    ask(line, 5)
    assert refused(line) == [(4, "TOO_MANY_SESSIONS"), (5, "TOO_MANY_SESSIONS")]
    store.gate.set()
    await until_true(lambda: len(refused(line)) == 4)
    await until_true(lambda: not line.stream.peer.waiting_bytes)
    ask(line, 5)
    assert line.stream.num_sessions == 2, "sessions that were not kept have no place"
    await asyncio.to_thread(durability.close)


@pytest.mark.parametrize("is_going_away", [False, True])
async def test_ending_stream_and_draining_server_refuse_opens(is_going_away: bool) -> None:
    line = Line()
    if is_going_away:
        line.stream.accepts_opens = False
    else:  # as if no engine were left: there may be one again before the client has read that
        line.stream.end()
    ask(line, 1)
    assert refused(line) == [(1, "DRAINING")]
    assert line.engine.events == []


async def test_close_is_accepted_beyond_the_rate_limit() -> None:
    line, now = Line(make_catalog(events_per_second=3.0)), time.monotonic()
    line.open()
    for event_seq in range(2, 8):
        line.send(event_seq, at=now, set_play_state=PAUSE)
    line.send(8, at=now, close=session_pb2.CloseSession())
    assert [seq for seq, _ in line.refusals()][-1] == 7
    assert (line.engine.kinds()[0], line.engine.kinds()[-1]) == (Open, Close)


async def test_late_answer_to_an_ended_session_is_not_taken_for_the_next_one_s() -> None:
    """The answer to an event that was on its way to the engine when the engine ended the session."""
    line = Line()
    line.open()
    key = line.engine.events[0].session
    line.send(2, set_play_state=PAUSE)
    line.stream.take(Closed(key, CloseReason.IDLE, Code.OK, "", 0, 0))
    line.send(1, open=session_pb2.OpenSession(request_id="second"))
    late = Outcome(key, 2, Code.NOT_FOUND, reason="SESSION_NOT_OPEN")
    line.stream.take(late)
    line.stream.take(Opened(key, 1, 0, 40, 4, 4, "tiny", "stick", 20))
    line.stream.take(late)
    assert (line.refusals(), line.updates()[-1].applied_seq) == ([], 1)
    line.send(2, set_play_state=PAUSE)
    line.stream.take(Outcome(key, 2, Code.OK))
    assert line.updates()[-1].applied_seq == 2


async def test_events_behind_an_open_refused_by_a_lost_engine_are_answered() -> None:
    line = Line()
    line.send(1, open=session_pb2.OpenSession())
    key = line.engine.events[0].session
    line.engine.submit = lambda event: Outcome(key, event.event_seq, Code.UNAVAILABLE, reason="ENGINE_RESTARTING")  # type: ignore[method-assign]
    line.send(2, set_play_state=PAUSE)
    line.stream.take(Outcome(key, 1, Code.UNAVAILABLE, reason="ENGINE_RESTARTING"))
    assert line.refusals() == [(2, "ENGINE_RESTARTING"), (1, "ENGINE_RESTARTING")]


@pytest.mark.parametrize("model_id", ["", "fake"])
async def test_refusal_for_a_failed_model_names_other_servers(model_id: str) -> None:
    line = Line()
    served = line.models.default
    served.refusal = model_failed(served.model_id, "its weights have changed")
    line.stream.other_servers = lambda model_id: (OtherServer(f"{model_id}.example", ""),)
    ask(line, 1, session_pb2.OpenSession(model_id=model_id and served.model_id))
    (told,) = [update.outcome for update in line.updates()]
    assert told.reason == "MODEL_FAILED"
    assert [each.address for each in told.other_servers] == [f"{served.model_id}.example"]
    ask(line, 2, session_pb2.OpenSession(model_id="another"))
    assert line.updates()[-1].outcome.reason == "UNKNOWN_MODEL"
    assert not line.updates()[-1].outcome.other_servers
