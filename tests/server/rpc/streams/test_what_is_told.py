"""What is sent about a session and what is not: during a resume, to a slow reader, and without a session."""

from __future__ import annotations

import asyncio
import time
from collections import Counter

import numpy as np
import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Chunk,
    Closed,
    CloseReason,
    Code,
    Open,
    Outcome,
    PlanCause,
    PlanNotice,
    Resumed,
    SessionKey,
)
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.stream_metrics import NoStreamMetrics
from tests.server.rpc.sessions.test_kept_sessions import resume, token_of
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, WALK, Line, make_catalog

KEY = SessionKey(1, HANDLE)
FRAMES = (
    PlanNotice(KEY, 2, 0, PlanCause.EDIT, (2,)),
    Chunk(KEY, 2, 0, np.zeros((8, 3), np.float32), 0),
)


class Metrics(NoStreamMetrics):
    """Counts refusals for lack of room, and what becomes of resumes."""

    def __init__(self) -> None:
        self.rejects: Counter[str] = Counter()
        self.resumes: Counter[str] = Counter()

    def reject(self, reason: str) -> None:
        self.rejects[reason] += 1

    def count_resume(self, how: str) -> None:
        self.resumes[how] += 1


def kinds(line: Line) -> list[str | None]:
    return [update.WhichOneof("update") for update in line.updates()]


async def test_resumed_session_sends_answers_with_opened_and_then_frames() -> None:
    kept = KeptSessions(30.0)
    line = Line(kept=kept)
    line.open()
    line.send(2, set_play_state=PAUSE)
    other = resume(kept, line.engine, token_of(line))
    other.stream.take(*FRAMES, Outcome(KEY, 2, Code.OK))
    assert kinds(other) == []
    other.stream.take(Resumed(KEY, 1, 0), *FRAMES)
    assert kinds(other) == ["opened", "outcome", "plan", "chunk"]


async def test_updates_of_a_resumed_session_use_its_new_handle() -> None:
    kept = KeptSessions(30.0)
    line, other = Line(kept=kept), Line(kept=kept, number=2)
    line.open()
    opening = session_pb2.OpenSession(
        resume_token=token_of(line), resume_point=session_pb2.ResumePoint(attempt=1, answered_seq=1)
    )
    other.stream.receive(session_pb2.SessionEvent(session=99, event_seq=1, open=opening), time.monotonic())
    other.stream.take(Resumed(KEY, 1, 0), *FRAMES, Outcome(KEY, 2, Code.OK))
    other.stream.take(Closed(KEY, CloseReason.IDLE, Code.OK, "", 0, 0))
    assert [update.session for update in other.updates()] == [99] * 5
    assert kinds(line)[-1] == "closed", "the stream that had the session is told that it was closed there"


async def test_events_behind_a_refused_open_are_answered_and_not_reused() -> None:
    line = Line()
    line.send(1, open=session_pb2.OpenSession())
    line.send(2, edit_prompts=WALK)
    line.stream.take(Outcome(KEY, 1, Code.RESOURCE_EXHAUSTED, reason="OVERLOADED"))
    assert line.refusals() == [(2, "SESSION_CLOSED"), (1, "OVERLOADED")]
    line.prompts.go.set()
    line.send(1, open=session_pb2.OpenSession())
    for _ in range(10):
        await asyncio.sleep(0)
    assert line.engine.kinds() == [Open, Open]


async def test_resume_with_an_older_attempt_is_superseded() -> None:
    kept = KeptSessions(30.0)
    line = Line(kept=kept)
    line.open()
    token = token_of(line)
    resume(kept, line.engine, token, attempt=3)
    for attempt in (2, 3):
        assert resume(kept, line.engine, token, attempt=attempt).refusals() == [(1, "RESUME_SUPERSEDED")]
    assert resume(kept, line.engine, token, attempt=4).refusals() == []


async def test_frames_and_playheads_without_a_session_are_dropped() -> None:
    line = Line()
    line.stream.take(*FRAMES)
    line.send(0, playhead=session_pb2.Playhead(frame=3))
    assert kinds(line) == []
    assert line.engine.events == []


async def test_slow_reader_gets_no_more_frames_and_its_session_is_not_kept() -> None:
    kept = KeptSessions(30.0)
    line = Line(make_catalog(hard_backlog_bytes=4_000, soft_backlog_bytes=4_000), kept=kept)
    line.open()
    line.stream.take(PlanNotice(KEY, 1, 0, PlanCause.CONTINUE, ()))
    for first in range(0, 400, 80):
        line.stream.take(Chunk(KEY, 1, first, np.zeros((80, 3), np.float32), 0))
    line.stream.take(*FRAMES)
    assert "chunk" not in kinds(line)
    assert kinds(line).count("plan") == 1
    line.stream.lose()
    assert kept.num_parked == 0


async def test_playheads_beyond_the_rate_limit_are_refused_and_use_no_number() -> None:
    line, now = Line(make_catalog(events_per_second=3.0)), time.monotonic()
    line.open()
    for _ in range(5):
        line.send(0, at=now, playhead=session_pb2.Playhead(frame=3))
    line.send(2, at=now + 1.0, set_play_state=PAUSE)
    assert set(line.refusals()) == {(0, "TOO_MANY_EVENTS")}
    assert line.engine.events[-1].event_seq == 2


@pytest.mark.parametrize("is_full", [True, False])
async def test_only_opens_refused_for_lack_of_room_are_counted_by_reason(
    is_full: bool,
) -> None:
    metrics = Metrics()
    line = Line(make_catalog(max_sessions_per_stream=1 - is_full), metrics=metrics)
    line.send(1, open=session_pb2.OpenSession(model_id="" if is_full else "none"))
    assert len(line.refusals()) == 1
    assert metrics.rejects == ({"TOO_MANY_SESSIONS": 1} if is_full else {})


async def test_close_all_returns_the_number_of_sessions_it_closes() -> None:
    line = Line()
    line.open()
    assert line.stream.close_all(CloseReason.MODEL_UNLOADED, line.models.default) == 1
    assert line.stream.close_all(CloseReason.DRAINED) == 0, "it is closing already"
