"""Messages that were read and are not paid for: counted while they are held, bounded for a peer, then let go."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from dataclasses import dataclass
from typing import cast

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.budgets.held_requests import Ended, HeldRequests
from motiongen_server.rpc.errors.streams import hello_expected
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.limits import PeerLimits, ServiceLimits
from motiongen_server.rpc.request_parts import TAKEN_APART
from motiongen_server.rpc.streams.reader import StreamReader
from tests.contract.local import LocalServer
from tests.server.rpc.streams.test_event_order import Line
from tests.server.rpc.streams.test_stream_watch import connected, end_of, talk_on
from tests.waiting import LIMIT_S, until_true

MOST = 1000
LONG = service_pb2.StreamMotionRequest(events=[session_pb2.SessionEvent()] * 50_000)
HELLO = service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()).SerializeToString()


@dataclass(eq=False)
class Holder:
    """A stream that owes so many seconds."""

    owes_s: float
    refusal: StreamRefused | None = None

    def owed_s(self, now: float) -> float:
        return self.owes_s

    def refuse(self, refusal: StreamRefused) -> None:
        self.refusal = refusal


def test_what_is_held_is_counted_for_as_long() -> None:
    held, stream = HeldRequests(), Holder(1.0)
    with held.holding(stream, MOST, MOST, "address"):
        assert (held.num_bytes, held.of(stream)) == (MOST, MOST)
    assert (held.num_bytes, held.of(stream)) == (0, 0)
    assert stream.refusal is None


def test_beyond_what_a_peer_may_have_held_those_that_owe_most_are_ended() -> None:
    held, streams = HeldRequests(), [Holder(each) for each in (0.0, 7.0, 3.0, 0.0)]
    with ExitStack() as blocks:
        for stream in streams:
            blocks.enter_context(held.holding(stream, MOST // 2 - 10, MOST, "address"))
        assert [stream.refusal is not None for stream in streams] == [False, True, True, False]
        assert held.num_bytes <= MOST
    assert held.num_bytes == 0


def test_a_stream_that_owes_most_itself_is_ended_and_its_message_is_let_go() -> None:
    held, other, stream = HeldRequests(), Holder(1.0), Holder(2.0)
    with held.holding(other, MOST, MOST, "address"):
        with pytest.raises(Ended), held.holding(stream, MOST, MOST, "address"):
            raise AssertionError("nothing of it is taken")
        assert stream.refusal is not None
        assert stream.refusal.reason == "TOO_MUCH_UNPAID"
        assert (other.refusal, held.num_bytes) == (None, MOST)


@pytest.mark.parametrize("owe_s", [[9.0], [0.0, 0.0, 0.0]], ids=["one alone", "nobody owes"])
def test_who_has_paid_or_is_alone_is_never_ended(owe_s: list[float]) -> None:
    held, streams = HeldRequests(), [Holder(each) for each in owe_s]
    with ExitStack() as blocks:
        for stream in streams:
            blocks.enter_context(held.holding(stream, 2 * MOST, MOST, "address"))
        assert [stream.refusal for stream in streams] == [None] * len(streams)
    assert held.num_bytes == 0


def test_those_that_came_at_one_moment_are_ended_once_they_owe() -> None:
    held, streams = HeldRequests(), [Holder(0.0) for _ in range(4)]
    with ExitStack() as blocks:
        for stream in streams:
            blocks.enter_context(held.holding(stream, MOST // 2, MOST, "address"))
        assert held.num_bytes == 2 * MOST
        for owe_s, stream in enumerate(streams, 1):
            stream.owes_s = owe_s
        held.bound(MOST, "address")
        assert [stream.refusal is not None for stream in streams] == [False, False, True, True]
        assert held.num_bytes == MOST


async def test_a_message_that_waits_to_be_paid_for_counts_among_what_waits_and_no_longer() -> None:
    limits = ServiceLimits(peer=PeerLimits(events_per_second=1.0))
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        connected(server) as (channel, _),
    ):
        call = channel.stream_stream("/motiongen.v1.MotionService/StreamMotion")()
        await call.write(HELLO)
        await call.write(LONG.SerializeToString())
        await until_true(lambda: server.service.num_waiting_bytes == TAKEN_APART * LONG.ByteSize())
        call.cancel()
        await until_true(lambda: not server.service.num_waiting_bytes)


async def test_streams_of_a_peer_that_have_too_much_held_are_ended_and_others_play_on() -> None:
    most = 3 * TAKEN_APART * LONG.ByteSize()
    limits = ServiceLimits(peer=PeerLimits(held_bytes=most))
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        connected(server) as (channel, catalog),
    ):
        good = await talk_on(channel, catalog).hello()
        await good.open(1)
        hostile = [await talk_on(channel, catalog).hello() for _ in range(6)]
        for talk in hostile:
            await talk.say(LONG)
        await until_true(lambda: server.service.num_streams <= 4)
        assert 0 < server.service.num_waiting_bytes <= most
        ends = [asyncio.create_task(end_of(talk)) for talk in hostile]
        ended, _ = await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        assert {end.result() for end in ended} == {(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MUCH_UNPAID")}
        await good.plays_on(1)
        for talk in hostile:
            talk.call.cancel()
        await asyncio.gather(*ends, return_exceptions=True)


class Message(bytes):
    """Tells when it is gone."""

    num_alive = 0

    def __new__(cls, content: bytes) -> Message:
        cls.num_alive += 1
        return super().__new__(cls, content)

    def __del__(self) -> None:
        Message.num_alive -= 1


class Context:
    """A client that says hello, then a long message, then nothing more for ever."""

    def __init__(self) -> None:
        self.is_waited_for = asyncio.Event()
        self._said = [HELLO, LONG.SerializeToString()]

    async def read(self) -> bytes:
        if self._said:
            return Message(self._said.pop(0))
        self.is_waited_for.set()
        await asyncio.Event().wait()
        raise AssertionError("nothing more comes")


async def test_a_message_is_let_go_once_it_is_taken_and_not_when_the_next_one_comes() -> None:
    line, context = Line(), Context()
    line.stream.peer.num_streams = 1
    reader = StreamReader(line.models, "replica")
    # It has no budget to wait for: every event of it is refused, and what that costs is never paid.
    line.stream.owed_s = lambda now: 0.0  # type: ignore[method-assign]
    reading = asyncio.create_task(reader.read(line.stream, cast(StreamContext, context)))
    async with asyncio.timeout(LIMIT_S):
        while not context.is_waited_for.is_set():
            line.updates()
            await asyncio.sleep(0)
    assert Message.num_alive == 0
    reading.cancel()


async def test_nothing_more_of_a_message_is_taken_once_its_stream_is_ended() -> None:
    line, context = Line(), Context()
    reading = asyncio.create_task(StreamReader(line.models, "replica").read(line.stream, cast(StreamContext, context)))
    await until_true(lambda: line.stream.peer.held.num_bytes)
    line.stream.refuse(hello_expected())
    await reading
    assert (line.stream.peer.held.num_bytes, Message.num_alive) == (0, 0)
