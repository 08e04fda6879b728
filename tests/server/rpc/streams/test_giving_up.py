"""Streams that are ended for a backlog or by a server fault: only these, once, and completely."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import NoReturn

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_compliance.heard import Heard
from motiongen_server.engine.types import Code, Outcome, Output, SessionKey
from motiongen_server.identity.callers import Callers
from motiongen_server.rpc.errors.streams import no_memory_left
from motiongen_server.rpc.limits import ServiceLimits
from motiongen_server.rpc.stream_metrics import NoStreamMetrics
from motiongen_server.rpc.streams import watch as stream_watch
from motiongen_server.rpc.streams.stream import Stream
from motiongen_server.rpc.streams.watch import StreamWatch
from tests.contract.local import LocalServer
from tests.logged import errors
from tests.server.rpc.streams.test_event_order import WALK, Line, make_catalog
from tests.server.rpc.streams.test_stream_watch import connected, end_of, talk_on
from tests.waiting import LIMIT_S

NUM_SESSIONS = 512
HARD_BYTES = 1 << 20
STRAY = SessionKey(1, NUM_SESSIONS + 1)


class Metrics(NoStreamMetrics):
    """Counts how often a slow reader was given up."""

    num_given_up = 0

    def give_up_on_reader(self) -> None:
        self.num_given_up += 1


@pytest.fixture
async def line() -> Line:
    """A stream with the most sessions allowed, each of whose opens waits for the encoder."""
    line = Line(make_catalog(hard_backlog_bytes=HARD_BYTES, soft_backlog_bytes=HARD_BYTES), metrics=Metrics())
    for handle in range(NUM_SESSIONS):
        opening = session_pb2.OpenSession(prompts=WALK.upsert)
        event = session_pb2.SessionEvent(session=handle, event_seq=1, open=opening)
        line.stream.receive(event, time.monotonic())
    assert line.stream.num_sessions == NUM_SESSIONS
    return line


def tell(line: Line, num_bytes: int) -> None:
    """Sends something that the client does not read."""
    line.stream.take(Outcome(STRAY, 2, Code.NOT_FOUND, reason="R", message="m" * num_bytes))


async def test_slow_reader_is_given_up_once_and_its_sessions_are_answered(line: Line) -> None:
    tell(line, HARD_BYTES)
    assert line.stream.num_sessions == 0
    assert sorted(line.refusals())[:NUM_SESSIONS] == [(1, "SESSION_CLOSED")] * NUM_SESSIONS
    assert isinstance(line.metrics, Metrics)
    assert line.metrics.num_given_up == 1


async def test_refused_stream_does_not_count_as_a_slow_reader_too(line: Line) -> None:
    tell(line, HARD_BYTES - 1000)
    line.stream.refuse(no_memory_left(1))
    assert (line.stream.num_sessions, line.stream.num_waiting_bytes) == (0, 0)
    assert isinstance(line.metrics, Metrics)
    assert line.metrics.num_given_up == 0


def stream_of(heard: Heard) -> int:
    """The number of the stream that a session was opened on."""
    assert heard.opened is not None
    return int(heard.opened.session_id.partition("-")[0])


def failing(*_: object) -> NoReturn:
    raise RuntimeError("a fault")


async def test_fault_in_a_stream_s_outputs_ends_only_that_stream(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    take_all, faulty = Stream.take_all, set[int]()

    def take(self: Stream, outputs: Sequence[Output]) -> None:
        if self.number in faulty:
            raise RuntimeError("a fault")
        take_all(self, outputs)

    monkeypatch.setattr(Stream, "take_all", take)
    async with asyncio.timeout(LIMIT_S), LocalServer() as server, connected(server) as (channel, catalog):
        first, other = talk_on(channel, catalog), talk_on(channel, catalog)
        heard = await (await first.hello()).open(1)
        faulty.add(stream_of(heard))
        number = stream_of(await (await other.hello()).open(1))
        told = Outcome(SessionKey(number, 9), 77, Code.NOT_FOUND, reason="TOLD", message="told")
        other.note(service_pb2.StreamMotionRequest(events=[session_pb2.SessionEvent(session=9, event_seq=77)]))
        server.service.deliver([*(Outcome(SessionKey(each, 1), 2, Code.OK) for each in faulty), told])
        assert await end_of(first) == (grpc.StatusCode.INTERNAL, "INTERNAL")
        await other.until(lambda: 9 in other.sessions and other.sessions[9].outcomes)
        await other.plays_on(1)
    assert len(errors(caplog)) == 1
    assert "error id" in errors(caplog)[0]


async def test_fault_in_watching_a_stream_ends_only_that_stream(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [Line(number=number) for number in range(1, 4)]
    streams = {line.stream.number: line.stream for line in lines}
    monkeypatch.setattr(streams[1], "lose", failing)
    watch = StreamWatch(ServiceLimits(hello_timeout_s=5.0), streams)
    for _ in range(2):
        watch.look(time.monotonic() + 6.0)
    reasons = [stream.refusal.reason for stream in streams.values() if stream.refusal is not None]
    assert reasons == ["INTERNAL", "HELLO_LATE", "HELLO_LATE"]
    assert len(errors(caplog)) == 1


async def test_watch_continues_after_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    looks, again = [0], asyncio.Event()

    class Failing(Callers):
        def look(self) -> None:
            looks[0] += 1
            if looks[0] == 1:
                failing()
            again.set()

    monkeypatch.setattr(stream_watch, "LOOK_EVERY_S", 0.0)
    streams = {1: Line().stream}
    StreamWatch(ServiceLimits(), streams, Failing()).begin()
    async with asyncio.timeout(LIMIT_S):
        await again.wait()
    streams.clear()
