"""Resuming a session: what is sent again, what continues, the takeover of a stream, and resumes that are refused."""

from __future__ import annotations

import copy

import grpc
import pytest

from motiongen.v1 import session_pb2
from motiongen_compliance.heard import Heard
from motiongen_compliance.messages import PAUSE, addressed, edit_prompts, span
from motiongen_compliance.talk import Talk
from motiongen_compliance.target import Target


async def lost(talk: Talk) -> None:
    """End a stream as the loss of its transport would."""
    talk.call.cancel()


async def test_resumed_session_continues_where_its_client_is(target: Target) -> None:
    first = await target.talk()
    heard = await first.open(1)
    await first.plays_on(1)
    await lost(first)
    before = heard.next_frame
    second = await target.talk()
    await second.resume(1, heard)
    assert heard.goes_on_at == before, "nothing is sent twice"
    await second.plays_on(1)
    assert (await second.edit(1, PAUSE)).code == 0
    assert (await second.close(1)).reason == session_pb2.CLOSE_REASON_CLIENT


async def test_frames_lost_on_the_way_are_sent_again(target: Target) -> None:
    first = await target.talk()
    heard = await first.ask_open(1)
    await first.until(lambda: heard.chunks)
    first.sessions[1] = copy.deepcopy(heard)  # as if later messages did not reach the client
    await first.plays_on(1)
    heard.playhead = first.sessions[1].playhead
    assert first.sessions[1].end > heard.end
    await lost(first)
    second = await target.talk()
    await second.resume(1, heard)
    await second.until(lambda: heard.end >= first.sessions[1].end)
    assert all(heard.frames[frame] == row for frame, row in first.sessions[1].frames.items())
    await second.plays_on(1)


async def test_plans_lost_on_the_way_are_replaced_by_one_resume_plan(target: Target) -> None:
    first = await target.talk()
    heard = await first.open(1)
    assert heard.opened is not None
    lookahead = heard.opened.lookahead_frames
    await first.until(lambda: heard.end >= lookahead)
    held, plan = heard.next_frame, heard.plans[-1].plan
    first.sessions[1] = copy.deepcopy(heard)  # as if later messages did not reach the client
    await first.send(*(addressed(edit_prompts(span(text)), 1, seq) for seq, text in ((2, "run"), (3, "dance"))))
    heard.sent_seq = 3
    await first.until(lambda: first.sessions[1].applied_seq >= 3)
    await lost(first)
    second = await target.talk()
    await second.resume(1, heard)
    await second.until(lambda: heard.plans[-1].plan > plan)
    notice = heard.plans[-1]
    assert notice.cause == session_pb2.PLAN_CAUSE_RESUME
    assert notice.valid_from < held
    assert {2, 3} >= set(notice.event_seqs)
    assert [heard.outcome(seq).code for seq in (2, 3)] == [0, 0]  # type: ignore[union-attr]
    await second.plays_on(1)


async def test_unconfirmed_answers_are_sent_again_and_repeated_events_dropped(
    target: Target,
) -> None:
    first = await target.talk()
    heard = await first.open(1)
    assert (await first.edit(1, edit_prompts(span("run")))).code == 0
    refused = await first.edit(1, edit_prompts(remove=[7]))
    heard.applied_seq = 1  # as if neither answer had been received
    heard.outcomes.clear()
    await lost(first)
    second = await target.talk()
    await second.resume(1, heard)
    assert (await second.answer(1, 3)) == refused
    assert (await second.answer(1, 2)).code == 0
    plans = len(heard.plans)
    await second.send(addressed(edit_prompts(span("run")), 1, 2), addressed(edit_prompts(remove=[7]), 1, 3))
    assert (await second.edit(1, PAUSE)).code == 0
    assert len(heard.plans) == plans, "events whose numbers were seen before are dropped"


async def test_confirmed_answers_are_not_sent_again(target: Target) -> None:
    first = await target.talk()
    heard = await first.open(1)
    for text in ("run", "dance"):
        await first.edit(1, edit_prompts(span(text)))
    await lost(first)
    second = await target.talk()
    await second.resume(1, heard)
    await second.edit(1, PAUSE)
    assert [outcome.event_seq for outcome in heard.outcomes] == [2, 3, 4]


async def test_resume_takes_the_session_over_from_a_stream_that_still_lives(target: Target) -> None:
    first, second = await target.talk(), await target.talk()
    heard = await first.open(1)
    other = await first.open(2)
    await second.resume(5, heard)
    first.sessions[1] = Heard(heard.row_bytes, opened=heard.opened)
    await first.until(lambda: first.sessions[1].closed is not None)
    closed = first.sessions[1].closed
    assert closed is not None
    assert closed.reason == session_pb2.CLOSE_REASON_TAKEN_OVER
    first.sessions[1] = Heard(heard.row_bytes)
    await first.send(addressed(PAUSE, 1, 2))
    assert (await first.answer(1, 2)).reason == "SESSION_NOT_OPEN"
    await first.send(session_pb2.SessionEvent(session=1, event_seq=1, open=session_pb2.OpenSession()))
    assert (await first.answer(1, 1)).reason == "HANDLE_IN_USE"
    await second.plays_on(5)
    await first.plays_on(2)
    assert other.closed is None
    await first.call.done_writing()
    assert await first.to_the_end() is grpc.StatusCode.OK
    await second.plays_on(5)


async def test_late_resume_of_an_older_attempt_is_refused(target: Target) -> None:
    first, second = await target.talk(), await target.talk()
    heard = await first.open(1)
    first.sessions[1] = copy.deepcopy(heard)
    heard.attempt = 1
    await second.resume(1, heard)
    point = session_pb2.ResumePoint(next_frame=0, attempt=1)
    assert heard.opened is not None
    late = session_pb2.OpenSession(resume_token=heard.opened.session_token, resume_point=point)
    first.sessions[3] = Heard(heard.row_bytes)
    await first.send(session_pb2.SessionEvent(session=3, event_seq=1, open=late))
    refused = await first.answer(3, 1)
    assert (refused.reason, refused.field) == ("RESUME_SUPERSEDED", "open.resume_point.attempt")
    assert "2" in refused.allowed
    await second.plays_on(1)


@pytest.mark.parametrize(
    ("fields", "reason", "field"),
    [
        ({"resume_token": "guessed"}, "SESSION_NOT_KEPT", "open.resume_token"),
        ({"seed": 3}, "NOT_FOR_RESUMING", "open.seed"),
        ({"resume_token": ""}, "RESUME_TOKEN_MISSING", "open.resume_point"),
        ({"resume_point": session_pb2.ResumePoint(attempt=9, next_frame=10_000, plan=1)}, "RESUME_OUT_OF_RANGE",
         "open.resume_point"),
        ({"resume_point": session_pb2.ResumePoint(attempt=9, plan=99)}, "RESUME_OUT_OF_RANGE", "open.resume_point"),
        ({"resume_point": None}, "RESUME_SUPERSEDED", "open.resume_point.attempt"),
    ],
)  # fmt: skip
async def test_invalid_resume_is_refused(target: Target, fields: dict[str, object], reason: str, field: str) -> None:
    first, second = await target.talk(), await target.talk()
    heard = await first.open(1)
    await lost(first)
    await second.ask_resume(1, heard, **fields)
    refused = await second.answer(1, 1)
    assert (refused.reason, refused.field) == (reason, field)
    assert refused.allowed
    heard.outcomes.clear()
    heard.attempt = 20
    await second.resume(1, heard)
    await second.plays_on(1)


async def test_resume_without_any_frames_starts_at_frame_0(target: Target) -> None:
    first, second = await target.talk(), await target.talk()
    heard = await first.open(1)
    assert heard.opened is not None
    await lost(first)
    fresh = Heard(heard.row_bytes, opened=heard.opened)
    await second.ask_resume(1, fresh, resume_point=session_pb2.ResumePoint(attempt=1))
    await second.until(lambda: fresh.chunks or fresh.outcomes)
    assert fresh.chunks, fresh.outcomes
    assert fresh.chunks[0].first_frame == 0
    await second.plays_on(1)


async def test_session_of_a_client_that_finished_writing_cannot_be_resumed(target: Target) -> None:
    first = await target.talk()
    heard = await first.open(1)
    await first.call.done_writing()
    assert await first.to_the_end() is grpc.StatusCode.OK
    second = await target.talk()
    heard.closed = None
    heard.applied_seq = 0
    await second.ask_resume(1, heard)
    assert (await second.answer(1, 1)).reason == "SESSION_NOT_KEPT"


async def test_edit_waiting_for_its_prompt_survives_a_lost_transport(target: Target) -> None:
    first = await target.talk()
    heard = await first.open(1)
    await first.send(addressed(edit_prompts(span("a prompt that has to be encoded first")), 1, 2))
    await first.ping(1)
    await lost(first)
    heard.sent_seq = 2
    heard.applied_seq = 1
    heard.outcomes.clear()
    second = await target.talk()
    await second.resume(1, heard)
    assert (await second.answer(1, 2)).code == 0
    await second.plays_on(1)
