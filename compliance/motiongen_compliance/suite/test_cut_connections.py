"""Connections that are cut, without an orderly end of their calls: nothing is lost or sent twice ("After a loss")."""

from __future__ import annotations

import asyncio

import grpc.aio

from motiongen_compliance.heard import Heard
from motiongen_compliance.line import TcpLine
from motiongen_compliance.messages import PAUSE, addressed, edit_prompts, span
from motiongen_compliance.talk import LIMIT_S, Talk
from motiongen_compliance.target import Target

CUT = (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.INTERNAL)
"""Status of a call that began on a connection which was then cut. INTERNAL comes from gRPC, when a write fails."""


async def cut(line: TcpLine, talk: Talk) -> None:
    """Cut the connection, and wait until the client has noticed."""
    line.cut()
    await talk.call.code()


async def come_back(distant: Target, heard: Heard) -> Talk:
    """Resume the session on a new stream. Returns the stream."""
    async with asyncio.timeout(LIMIT_S):
        while True:
            try:
                talk = await distant.talk()
            except grpc.aio.AioRpcError as lost:
                if lost.code() not in CUT:
                    raise  # a status in CUT: the call began on the connection that was cut
            else:
                await talk.resume(1, heard)
                return talk


async def test_session_resumes_after_every_cut_of_its_connection(distant: Target, line: TcpLine) -> None:
    talk = await distant.talk()
    heard = await talk.open(1)
    for _ in range(3):
        await talk.plays_on(1)
        await cut(line, talk)
        before = heard.next_frame
        talk = await come_back(distant, heard)
        assert heard.goes_on_at == before, "nothing is sent twice"
    await talk.plays_on(1)
    assert (await talk.edit(1, PAUSE)).code == 0


async def test_event_resent_after_a_cut_is_answered_once(distant: Target, line: TcpLine) -> None:
    talk = await distant.talk()
    heard = await talk.open(1)
    for seq in range(2, 8):
        event = addressed(edit_prompts(span(f"prompt number {seq}")), 1, seq)
        heard.sent_seq = seq
        await talk.send(event)
        await cut(line, talk)  # it may or may not have reached the server
        talk = await come_back(distant, heard)
        await talk.send(event)
        assert (await talk.answer(1, seq)).code == 0
    assert (await talk.edit(1, PAUSE)).code == 0
    assert [outcome.event_seq for outcome in heard.outcomes] == list(range(2, 9))
    await talk.plays_on(1)
