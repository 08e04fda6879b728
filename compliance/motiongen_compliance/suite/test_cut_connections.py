"""Connections are cut, rather than calls ended: "After a loss" promises that nothing is lost or sent twice."""

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
    """A new stream, on which the session is resumed."""
    async with asyncio.timeout(LIMIT_S):
        while True:
            try:
                talk = await distant.talk()
            except grpc.aio.AioRpcError as lost:
                if lost.code() not in CUT:
                    raise  # with those, the call began on the connection that was cut
            else:
                await talk.resume(1, heard)
                return talk


async def test_a_session_goes_on_by_its_token_however_often_its_connection_is_cut(
    distant: Target, line: TcpLine
) -> None:
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


async def test_an_event_that_was_on_its_way_is_said_again_and_answered_once(distant: Target, line: TcpLine) -> None:
    talk = await distant.talk()
    heard = await talk.open(1)
    for seq in range(2, 8):
        event = addressed(edit_prompts(span(f"prompt number {seq}")), 1, seq)
        heard.sent_seq = seq
        await talk.send(event)
        await cut(line, talk)  # whether it reached the server is not known
        talk = await come_back(distant, heard)
        await talk.send(event)
        assert (await talk.answer(1, seq)).code == 0
    assert (await talk.edit(1, PAUSE)).code == 0
    assert [outcome.event_seq for outcome in heard.outcomes] == list(range(2, 9))
    await talk.plays_on(1)
