"""Servers that take a session and drop it at once, or send it from one to the other: each attempt waits longer."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import LinePolicy, MotionClient, StreamLost, convert
from motiongen_client.backoff import FIRST_DELAY_S, LONGEST_DELAY_S, Backoff
from motiongen_client.session import Session
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer, full
from tests.client.line import Line, frames, open_session, opened
from tests.client.synthetic import catalog
from tests.client.waiting import until


def num_openings(line: Line) -> int:
    return sum(event.HasField("open") for event in line.said)


async def dropped(session: Session, line: Line, clock: ManualClock, delay_s: float) -> bool:
    """Have the server close a session that it has just opened. Whether it is asked again after a delay."""
    before = num_openings(line)
    unavailable = grpc.StatusCode.UNAVAILABLE.value[0]
    closed = session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_ENGINE_FAULT, code=unavailable)
    session.hear(session_pb2.SessionUpdate(session=1, closed=closed))
    clock.advance(delay_s)
    for _ in range(5):  # until the timers that are due have run
        await asyncio.sleep(0)
    return num_openings(line) > before


@pytest.mark.parametrize("is_kept", [True, False], ids=["resumed", "opened anew"])
async def test_session_dropped_after_each_opening_is_asked_for_more_and_more_rarely_until_frames_come(
    clock: ManualClock, is_kept: bool
) -> None:
    line = Line()
    session = await open_session(line)
    session.hear(session_pb2.SessionUpdate(session=1, durability=session_pb2.SessionDurability(is_kept=is_kept)))
    for _ in range(10):
        assert await dropped(session, line, clock, LONGEST_DELAY_S)
        session.hear(opened())
    assert not await dropped(session, line, clock, FIRST_DELAY_S), "that it was opened ten times means nothing"
    clock.advance(LONGEST_DELAY_S)
    before = num_openings(line)
    await until(lambda: num_openings(line) > before)
    session.hear(opened())
    for update in frames(1):
        session.hear(update)
    assert await dropped(session, line, clock, FIRST_DELAY_S), "frames came: it may have served well for hours"


async def test_session_dropped_by_a_server_that_leaves_is_asked_for_on_the_next_call_only(clock: ManualClock) -> None:
    line = Line()
    session = await open_session(line)
    line.draining = True
    assert not await dropped(session, line, clock, LONGEST_DELAY_S)
    line.draining = False
    before = num_openings(line)
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    assert num_openings(line) == before + 1


@pytest.mark.parametrize("news", ["another call", "the end of the session"])
async def test_attempt_that_was_to_be_made_is_forgotten_after(clock: ManualClock, news: str) -> None:
    line = Line()
    session = await open_session(line)
    assert not await dropped(session, line, clock, 0.0)
    if news == "another call":
        line.call_number += 1  # on which the session has been asked for by itself
    else:
        session.fail(StreamLost("CANCELLED", "the stream was closed here"))
    before = num_openings(line)
    clock.advance(LONGEST_DELAY_S)
    for _ in range(5):
        await asyncio.sleep(0)
    assert num_openings(line) == before


async def test_session_to_continue_is_asked_for_once_at_each_of_two_full_servers_that_name_each_other(
    clock: ManualClock, server: FakeServer, other: FakeServer
) -> None:
    def asked(which: FakeServer) -> int:
        return sum(event.open.HasField("prior_frames") for stream in which.streams for event in stream.received)

    def waits() -> bool:
        return bool(asked(other)) and session.is_waiting and not client._elsewhere._moving

    async with MotionClient(server.address, other_addresses=[server.address, other.address]) as client:
        session = await client.open("walk")
        await until(lambda: session.playback.buffered_to)
        server.refuse, other.refuse = full((other.address, "")), full((server.address, ""))
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)
        await until(lambda: session.is_away)
        for _ in range(5):
            await asyncio.sleep(0)
        clock.advance(FIRST_DELAY_S)
        await until(lambda: waits() or asked(server) > 1)
        assert (asked(server), asked(other)) == (1, 1)


async def test_delays_between_calls_begin_anew_with_the_second_pong_of_one(
    clock: ManualClock, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun_anew: list[Backoff] = []
    monkeypatch.setattr(Backoff, "reset", lambda backoff: begun_anew.append(backoff))
    async with MotionClient(server.address, policy=LinePolicy(ping_s=5.0, pong_timeout_s=5.0)) as client:
        await client.open("walk")
        assert client._own_stream is not None
        calls = client._own_stream._calls
        for num_resets in (0, 1):
            await until(lambda: calls._ponged.is_set() and not calls._pinged_ns)
            clock.advance(5.0)
            await until(lambda: not calls._ponged.is_set())  # until the next ping
            assert begun_anew.count(calls._backoff) == num_resets
