"""Answers that are kept for a client that resumes: how many, and which parts are dropped first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Chunk,
    Code,
    ConstraintReached,
    Opened,
    Outcome,
    Placement,
    PlanCause,
    PlanNotice,
    Resumed,
    SessionKey,
    Warned,
)
from motiongen_server.rpc.sessions.kept_answers import (
    MAX_KEPT_ANSWERS,
    MAX_KEPT_BYTES,
    PLACEMENT_OBJECT_BYTES,
    KeptAnswers,
)
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.snapshots.record import MAX_BYTES, write_record
from tests.server.rpc.streams.test_event_order import PAUSE, Line
from tests.server.snapshots.records import a_record

KEY = SessionKey(1, 7)
FULL = tuple(Placement(number, 2**40, 2**40, 2**40, 2**40, 1.5, 2.5, 0.5) for number in range(256))


def placed(event_seq: int) -> Outcome:
    """The answer to an edit of the most constraints allowed, all of which the engine has placed."""
    return Outcome(KEY, event_seq, Code.OK, 80, placements=FULL)


@pytest.fixture
def kept() -> KeptAnswers:
    """The answers kept for a client that never confirms any."""
    kept = KeptAnswers()
    for event_seq in range(2, 502):
        kept.keep(placed(event_seq))
    return kept


def test_newest_answers_are_kept_whole_and_older_ones_without_placements(kept: KeptAnswers) -> None:
    answers = list(kept)
    assert [answer.event_seq for answer in answers] == list(range(502 - MAX_KEPT_ANSWERS, 502))
    assert {(answer.code, answer.effective_frame) for answer in answers} == {(Code.OK, 80)}
    num_whole = sum(answer.placements == FULL for answer in answers)
    assert num_whole >= 2
    assert all(answer.placements == FULL for answer in answers[-num_whole:])


def test_kept_answers_are_bounded_in_memory_and_in_a_record(kept: KeptAnswers) -> None:
    assert kept.num_bytes <= MAX_KEPT_BYTES
    without = replace(a_record(), answers=())
    with_them = replace(without, answers=kept.up_to(501))
    assert len(write_record(with_them)) < len(write_record(without)) + MAX_KEPT_BYTES / 2
    assert MAX_KEPT_BYTES < MAX_BYTES / 2


def test_answers_with_long_texts_are_bounded_too() -> None:
    kept = KeptAnswers()
    for event_seq in range(2, 102):
        kept.keep(Outcome(KEY, event_seq, Code.NOT_FOUND, None, "R", allowed="a" * 10_000))
    assert kept.num_bytes <= MAX_KEPT_BYTES
    assert [answer.event_seq for answer in kept] == list(range(102 - len(kept), 102))


def test_warnings_are_dropped_together_with_placements() -> None:
    kept = KeptAnswers()
    kept.keep(replace(placed(2), warnings=(Warned("R", "m", "f"),)))
    for event_seq in range(3, 8):
        kept.keep(placed(event_seq))
    assert next(iter(kept)) == Outcome(KEY, 2, Code.OK, 80)


def test_confirmed_answers_are_dropped(kept: KeptAnswers) -> None:
    kept.confirm(500)
    assert list(kept) == [placed(501)]
    kept.confirm(501)
    assert (len(kept), kept.num_bytes) == (0, 0)


def test_let_go_of_places_drops_placements_and_warnings_but_no_answers() -> None:
    kept, warned = KeptAnswers(), (Warned("R", "m", "f"),)
    plain = [Outcome(KEY, event_seq, Code.OK, 80) for event_seq in range(2, 6)]
    for answer, more in zip(plain, ({}, {"placements": FULL}, {"warnings": warned}), strict=False):
        kept.keep(replace(answer, **more))
    kept.let_go_of_places()
    assert list(kept) == plain[:3]
    least = KeptAnswers()
    for answer in plain[:3]:
        least.keep(answer)
    assert kept.num_bytes == least.num_bytes


async def test_kept_answers_count_as_waiting_bytes_until_they_are_confirmed() -> None:
    line = Line(kept=KeptSessions(30.0))
    line.open()
    line.send(2, set_play_state=PAUSE)
    line.stream.take(placed(2))
    assert line.updates()[-1].outcome.event_seq == 2
    assert line.stream.num_waiting_bytes > 256 * PLACEMENT_OBJECT_BYTES
    line.send(0, playhead=session_pb2.Playhead(frame=0, answered_seq=2))
    assert line.stream.num_waiting_bytes == 0


@pytest.mark.parametrize("grace_s", [30.0, 0.0])
async def test_placements_of_an_opening_are_dropped_once_it_is_confirmed(grace_s: float) -> None:
    """The client of a character that walks a path given at the opening may send nothing but playheads."""
    line = Line(kept=KeptSessions(grace_s))
    line.send(1, open=session_pb2.OpenSession())
    line.stream.take(Opened(line.engine.events[0].session, 1, 0, 40, 4, 4, "tiny", "stick", 20, placements=FULL))
    assert len(line.updates()[0].opened.placements) == len(FULL)
    assert line.stream.num_waiting_bytes == 256 * PLACEMENT_OBJECT_BYTES
    line.send(0, playhead=session_pb2.Playhead(frame=0))
    assert line.stream.num_waiting_bytes == 256 * PLACEMENT_OBJECT_BYTES, "the client has not confirmed the opening"
    line.send(0, playhead=session_pb2.Playhead(frame=0, answered_seq=1))
    assert line.stream.num_waiting_bytes == 0


async def test_client_that_resumes_without_any_answer_is_sent_the_placements_of_the_opening() -> None:
    line = Line(kept=(kept := KeptSessions(30.0)))
    line.send(1, open=session_pb2.OpenSession())
    key = line.engine.events[0].session
    line.stream.take(Opened(key, 1, 0, 40, 4, 4, "tiny", "stick", 20, placements=FULL))
    token = line.updates()[0].opened.session_token
    line.stream.lose()
    again = Line(engine=line.engine, kept=kept, number=2)
    point = session_pb2.ResumePoint(attempt=1)
    again.send(1, open=session_pb2.OpenSession(resume_token=token, resume_point=point))
    again.stream.take(Resumed(key, 1, 0))
    (opened,) = (update.opened for update in again.updates() if update.HasField("opened"))
    assert len(opened.placements) == len(FULL)


async def test_reached_constraint_is_kept_until_a_frame_sent_after_it_is_shown() -> None:
    """However long ago the nearest frame was: for a range of frames, the news comes with the last of them."""
    line = Line(kept=(kept := KeptSessions(30.0)))
    line.open()
    key, rows = line.engine.events[0].session, np.zeros((60, 3), np.float32)
    reached = ConstraintReached(key, 3, False, 5, 1, None, None, None)
    line.stream.take(PlanNotice(key, 1, 0, PlanCause.CONTINUE, ()), Chunk(key, 1, 0, rows, 20), reached)
    entry = kept.find(line.updates()[0].opened.session_token)
    assert entry is not None
    line.send(0, playhead=session_pb2.Playhead(frame=59))
    assert reached in entry.welcome_back(60, None)
    line.stream.take(Chunk(key, 1, 60, rows, 80))
    line.send(0, playhead=session_pb2.Playhead(frame=60))
    assert reached not in entry.welcome_back(60, None)


async def test_plan_that_replaces_frames_does_not_lower_how_far_its_session_was_sent() -> None:
    """Otherwise news of constraints would be dropped before the client shows frames that were sent after them."""
    kept = KeptSessions(30.0)
    line = Line(kept=kept)
    line.open()
    (update,) = (each for each in line.updates() if each.HasField("opened"))
    for plan, first_frame, count in ((1, 0, 20), (2, 8, 4)):
        line.stream.take(Chunk(KEY, plan, first_frame, np.zeros((count, 3), np.float32), 0))
    entry = kept.find(update.opened.session_token)
    assert entry is not None
    assert entry.sent_to == 20
