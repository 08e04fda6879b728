"""How sessions and streams end when the client closes them or finishes writing."""

from __future__ import annotations

import grpc

from motiongen.v1 import session_pb2
from motiongen_compliance.messages import addressed, close, edit_prompts, span
from motiongen_compliance.target import Target


async def test_close_is_answered_with_the_number_of_frames(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    await talk.open(2)
    await talk.plays_on(1)
    closed = await talk.close(1)
    assert (closed.reason, closed.code) == (session_pb2.CLOSE_REASON_CLIENT, 0)
    assert closed.frames == heard.end
    assert heard.applied_seq == 2
    await talk.plays_on(2)


async def test_finished_client_gets_its_sessions_closed_and_status_ok(target: Target) -> None:
    talk, other = await target.talk(), await target.talk()
    await other.open(1)
    for handle in (1, 2, 3):
        await talk.open(handle)
    await talk.call.done_writing()
    assert await talk.to_the_end() is grpc.StatusCode.OK
    ends = [talk.sessions[handle].closed for handle in (1, 2, 3)]
    assert [end.reason for end in ends if end is not None] == [session_pb2.CLOSE_REASON_CLIENT] * 3
    await other.plays_on(1)


async def test_stream_without_sessions_ends_with_status_ok(target: Target) -> None:
    talk = await target.talk()
    await talk.call.done_writing()
    assert await talk.to_the_end() is grpc.StatusCode.OK


async def test_events_sent_before_finishing_are_answered(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    await talk.send(addressed(edit_prompts(span("dance")), 1, 2), addressed(close(), 1, 3))
    await talk.call.done_writing()
    assert await talk.to_the_end() is grpc.StatusCode.OK
    assert heard.outcome(2) is not None
    assert heard.closed is not None
    assert heard.applied_seq == 3
