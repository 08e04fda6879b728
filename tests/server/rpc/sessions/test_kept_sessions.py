"""Sessions that outlive their streams: which can be resumed, and which are only kept until the engine ends them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Close,
    Closed,
    CloseReason,
    Code,
    ConstraintReached,
    Open,
    Outcome,
    Resume,
    Resumed,
    SessionKey,
    SnapshotTaken,
)
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from tests.server.rpc.sessions.test_kept_answers import placed
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, Engine, Line
from tests.server.snapshots.kept import Store
from tests.server.snapshots.records import a_record
from tests.waiting import until_true

KEY = SessionKey(1, HANDLE)


@pytest.fixture
async def kept() -> KeptSessions:
    return KeptSessions(30.0)


@pytest.fixture
async def line(kept: KeptSessions) -> Line:
    return Line(kept=kept)


def token_of(line: Line) -> str:
    return next(update.opened.session_token for update in line.updates() if update.HasField("opened"))


def resume(kept: KeptSessions, engine: Engine, token: str, attempt: int = 1) -> Line:
    """Another stream, which resumes the session."""
    line = Line(engine=engine, kept=kept, number=1 + attempt)
    point = session_pb2.ResumePoint(attempt=attempt, answered_seq=1)
    line.send(1, open=session_pb2.OpenSession(resume_token=token, resume_point=point))
    return line


async def test_session_whose_stream_is_lost_can_be_resumed(line: Line, kept: KeptSessions) -> None:
    line.open()
    line.stream.lose()
    assert kept.num_parked == 1
    assert resume(kept, line.engine, token_of(line)).refusals() == []
    assert kept.num_parked == 0, "no session waits for its client any more"
    assert line.engine.kinds() == [Open, Resume]


async def test_resume_cancels_the_timer_of_the_grace_period(
    line: Line, kept: KeptSessions, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, timers = asyncio.get_running_loop(), list[asyncio.TimerHandle]()
    call_later = loop.call_later

    def note(delay_s: float, *what: Any) -> asyncio.TimerHandle:
        assert delay_s == 30.0
        timers.append(call_later(delay_s, *what))
        return timers[-1]

    monkeypatch.setattr(loop, "call_later", note)
    line.open()
    line.stream.lose()
    (timer,) = timers
    assert not timer.cancelled()
    resume(kept, line.engine, token_of(line))
    assert timer.cancelled()


async def test_session_that_its_client_has_closed_cannot_be_resumed(line: Line, kept: KeptSessions) -> None:
    line.open()
    token = token_of(line)
    line.stream.close_all(CloseReason.CLIENT)
    line.stream.end()
    line.stream.lose()
    assert resume(kept, line.engine, token).refusals() == [(1, "SESSION_NOT_KEPT")]
    assert line.engine.kinds() == [Open, Close]


async def test_session_without_a_stream_is_forgotten_after_its_end(line: Line, kept: KeptSessions) -> None:
    line.open()
    line.stream.end()
    line.stream.lose()
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0))
    assert not kept.has_away
    assert kept.num_parked == 0


async def test_bytes_of_a_closing_session_move_from_its_stream_and_count_once(line: Line, kept: KeptSessions) -> None:
    line.open()
    line.send(2, set_play_state=PAUSE)
    line.stream.take(placed(2))
    line.updates()
    held = line.stream.num_waiting_bytes
    line.stream.end()
    line.stream.lose()
    assert (line.stream.num_waiting_bytes, kept.num_waiting_bytes) == (0, held)


async def test_session_that_ends_while_its_client_is_away_frees_its_place(line: Line, kept: KeptSessions) -> None:
    """For example when another server has taken it over, and counts it there."""
    line.open()
    line.stream.lose()
    assert line.stream.peer.num_sessions == 1
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(Closed(KEY, CloseReason.TAKEN_OVER, Code.OK, "", 0, 0))
    assert (kept.num_parked, line.stream.peer.num_sessions) == (1, 0), "its client may still come and learn of its end"
    again = resume(kept, line.engine, token_of(line))
    assert again.updates()[-1].HasField("closed")
    assert (kept.num_parked, line.stream.peer.num_sessions) == (0, 0)


async def test_session_that_ended_while_its_client_was_away_is_forgotten_after_the_grace_period(
    line: Line, kept: KeptSessions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its engine has answered everything, and would say nothing more of it."""
    loop, timers = asyncio.get_running_loop(), list[Any]()
    begin = loop.call_later

    def note(delay_s: float, *what: Any) -> asyncio.TimerHandle:
        timers.append(what)
        return begin(delay_s, *what)

    monkeypatch.setattr(loop, "call_later", note)
    line.open()
    token = token_of(line)
    line.stream.lose()
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(Closed(KEY, CloseReason.ENGINE_FAULT, Code.UNAVAILABLE, "lost", 0, 0))
    assert kept.has_away
    ((give_up, *of),) = timers
    give_up(*of)
    assert not kept.has_away
    assert line.engine.kinds() == [Open]
    assert resume(kept, line.engine, token).refusals() == [(1, "SESSION_NOT_KEPT")]


async def test_closing_session_is_kept_until_the_engine_has_ended_it(line: Line, kept: KeptSessions) -> None:
    line.open()
    line.send(2, set_play_state=session_pb2.SetPlayState())
    line.stream.close_all(CloseReason.CLIENT)
    line.stream.end()
    line.stream.lose()
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(Outcome(KEY, 2, Code.OK))
    carrier.take(Outcome(KEY, 1, Code.OK))
    assert kept.carrier_of(KEY) is carrier
    carrier.take(Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0))
    assert not kept.has_away


async def test_session_refused_after_its_stream_was_lost_is_forgotten(line: Line, kept: KeptSessions) -> None:
    line.send(1, open=session_pb2.OpenSession())
    line.stream.lose()
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(Outcome(KEY, 1, Code.RESOURCE_EXHAUSTED))
    assert not kept.has_away
    line.stream.lose()  # once more, as the call ends, which pending writes may have delayed
    assert not kept.has_away, "its end is reported only once"


async def test_session_without_resume_grace_is_saved_if_there_is_a_store() -> None:
    """Its server may be lost as well."""
    store = Store()
    durability = Durability(store, asyncio.get_running_loop(), lambda _: None)
    line = Line(kept=KeptSessions(0.0, durability=durability))
    line.open()
    token = token_of(line)
    assert token, "a session without one is not saved"
    line.stream.take(SnapshotTaken(KEY, a_record().snapshot))
    await until_true(lambda: store.records)
    assert [*store.records] == [lease_of(token).name]
    line.stream.lose()
    assert line.engine.kinds() == [Open, Close], "it is closed at once nevertheless"
    await asyncio.to_thread(durability.close)


async def test_handle_of_a_session_resumed_by_another_stream_is_in_use_until_it_ends(
    line: Line, kept: KeptSessions
) -> None:
    line.open()
    other = resume(kept, line.engine, token_of(line))
    line.send(1, open=session_pb2.OpenSession())
    refused = next(update.outcome for update in line.updates() if update.HasField("outcome"))
    assert (refused.reason, refused.allowed.partition(",")[0]) == ("HANDLE_IN_USE", "another handle")
    other.stream.take(Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0))
    line.send(1, open=session_pb2.OpenSession())
    assert len(line.refusals()) == 1, "the session has ended"


async def test_refused_resume_closes_a_session_that_has_no_resume_grace() -> None:
    durability = Durability(Store(), asyncio.get_running_loop(), lambda _: None)
    kept = KeptSessions(0.0, durability=durability)
    line = Line(kept=kept)
    line.open()
    token = token_of(line)
    other = resume(kept, line.engine, token)
    place = line.stream.peer
    assert place.num_sessions == 1
    other.stream.take(Resumed(KEY, 1, None))
    assert other.refusals() == [(1, "RESUME_OUT_OF_RANGE")]
    assert line.engine.kinds() == [Open, Resume, Close]
    assert place.num_sessions == 0
    again = resume(kept, line.engine, token)
    await asyncio.sleep(0)
    assert again.refusals() == [], "the store is asked"
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    num_told = len(other.updates())
    carrier.take(Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0))
    assert len(other.updates()) == num_told, "the stream that could not resume it does not hear of its end"
    assert not kept.has_away
    await asyncio.to_thread(durability.close)


async def test_parked_session_is_closed_after_a_fault_in_its_bookkeeping(
    line: Line, kept: KeptSessions, caplog: pytest.LogCaptureFixture
) -> None:
    line.open()
    line.stream.lose()
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.fail(RuntimeError("a fault"))
    assert "error id" in caplog.text
    assert line.engine.kinds() == [Open, Close]
    assert (kept.num_parked, line.stream.peer.num_sessions) == (0, 0)
    carrier = kept.carrier_of(KEY)
    assert carrier is not None
    carrier.take(Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0))
    assert not kept.has_away


BOTH = {"lookahead_frames": 60, "denoise_steps": 8}


@pytest.mark.parametrize(
    ("asked", "is_taken", "told"),
    [
        ({"lookahead_frames": 60}, True, (60, 4)),
        ({"denoise_steps": 8}, True, (40, 8)),
        (BOTH, True, (60, 8)),
        (BOTH, False, (40, 4)),
    ],
)
async def test_resuming_client_is_told_the_options_now_in_force(
    line: Line, kept: KeptSessions, asked: dict[str, int], is_taken: bool, told: tuple[int, int]
) -> None:
    line.open()
    token = token_of(line)
    line.send(2, set_options=session_pb2.SetOptions(**asked))  # type: ignore[arg-type]
    line.stream.take(Outcome(KEY, 2, Code.OK if is_taken else Code.RESOURCE_EXHAUSTED))
    line.stream.lose()
    other = resume(kept, line.engine, token)
    other.stream.take(Resumed(KEY, 1, 0))
    opened = next(update.opened for update in other.updates() if update.HasField("opened"))
    assert (opened.lookahead_frames, opened.denoise_steps) == told


async def test_close_parked_closes_each_parked_session_once(line: Line, kept: KeptSessions) -> None:
    line.open()
    assert kept.close_parked(CloseReason.DRAINED) == 0, "a stream carries it"
    line.stream.lose()
    assert [kept.close_parked(CloseReason.DRAINED) for _ in range(2)] == [1, 0]
    assert line.engine.kinds() == [Open, Close]


async def test_reached_constraint_is_kept_until_frames_sent_after_it_are_shown(line: Line, kept: KeptSessions) -> None:
    line.open()
    entry = kept.find(token_of(line))
    assert entry is not None
    news = [ConstraintReached(KEY, number, True, frame, 1, None, None, None) for number, frame in ((1, 10), (2, 60))]
    for each, sent_to in zip(news, (20, 80), strict=True):
        entry.sent_to = sent_to
        entry.note(each)
    for shown, left in ((19, news), (20, news[1:]), (79, news[1:]), (80, [])):
        entry.note_shown(shown)
        assert [said for said, _ in entry.reached] == left
