"""Messages that were read and are not yet paid for: they are counted while held, bounded per peer, and then freed."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, cast

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
    """A stream that is in debt for that many seconds."""

    owes_s: float
    refusal: StreamRefused | None = None

    def owed_s(self, now: float) -> float:
        return self.owes_s

    def refuse(self, refusal: StreamRefused) -> None:
        self.refusal = refusal


def test_held_bytes_are_counted_while_they_are_held() -> None:
    held, stream = HeldRequests(), Holder(1.0)
    with held.holding(stream, MOST, MOST, "address"):
        assert (held.num_bytes, held.of(stream)) == (MOST, MOST)
    assert (held.num_bytes, held.of(stream)) == (0, 0)
    assert stream.refusal is None


def test_streams_most_in_debt_are_ended_when_a_peer_holds_too_much() -> None:
    held, streams = HeldRequests(), [Holder(each) for each in (0.0, 7.0, 3.0, 0.0)]
    with ExitStack() as blocks:
        for stream in streams:
            blocks.enter_context(held.holding(stream, MOST // 2 - 10, MOST, "address"))
        assert [stream.refusal is not None for stream in streams] == [False, True, True, False]
        assert held.num_bytes <= MOST
    assert held.num_bytes == 0


def test_new_holder_most_in_debt_is_ended_and_its_message_is_freed() -> None:
    held, other, stream = HeldRequests(), Holder(1.0), Holder(2.0)
    with held.holding(other, MOST, MOST, "address"):
        with pytest.raises(Ended), held.holding(stream, MOST, MOST, "address"):
            raise AssertionError("nothing of the message may be processed")
        assert stream.refusal is not None
        assert stream.refusal.reason == "TOO_MUCH_UNPAID"
        assert (other.refusal, held.num_bytes) == (None, MOST)


@pytest.mark.parametrize("owe_s", [[9.0], [0.0, 0.0, 0.0]], ids=["one alone", "nobody owes"])
def test_streams_without_debt_or_alone_are_never_ended(owe_s: list[float]) -> None:
    held, streams = HeldRequests(), [Holder(each) for each in owe_s]
    with ExitStack() as blocks:
        for stream in streams:
            blocks.enter_context(held.holding(stream, 2 * MOST, MOST, "address"))
        assert [stream.refusal for stream in streams] == [None] * len(streams)
    assert held.num_bytes == 0


def test_bound_ends_streams_that_fell_into_debt_since_they_came() -> None:
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


async def test_message_counts_as_waiting_until_it_is_paid_or_its_call_ends() -> None:
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


async def test_streams_are_ended_for_too_much_held_and_others_play_on() -> None:
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
    """A message; counts how many exist."""

    num_alive = 0

    def __new__(cls, content: bytes) -> Message:
        cls.num_alive += 1
        return super().__new__(cls, content)

    def __del__(self) -> None:
        Message.num_alive -= 1


class Context:
    """The context of a client that sends hello, then a long message, then nothing more for ever."""

    def __init__(self) -> None:
        self.is_waited_for = asyncio.Event()
        self._said = [HELLO, LONG.SerializeToString()]

    async def read(self) -> bytes:
        if self._said:
            return Message(self._said.pop(0))
        self.is_waited_for.set()
        await asyncio.Event().wait()
        raise AssertionError("nothing more comes")


async def test_message_is_freed_once_processed_and_not_when_the_next_comes() -> None:
    line, context = Line(), Context()
    line.stream.peer.num_streams = 1
    reader = StreamReader(line.models, "replica")
    # Without a debt to wait for: every event of the message is refused, and that cost would never be paid.
    line.stream.owed_s = lambda now: 0.0  # type: ignore[method-assign]
    reading = asyncio.create_task(reader.read(line.stream, cast(StreamContext, context)))
    async with asyncio.timeout(LIMIT_S):
        while not context.is_waited_for.is_set():
            line.updates()
            await asyncio.sleep(0)
    assert Message.num_alive == 0
    reading.cancel()


async def test_rest_of_a_message_is_dropped_and_freed_once_its_stream_is_ended() -> None:
    line, context = Line(), Context()
    receive, taken = line.stream.receive, [0]

    def counted(*event: Any) -> None:
        taken[0] += 1
        receive(*event)

    line.stream.receive = counted  # type: ignore[method-assign]
    reading = asyncio.create_task(StreamReader(line.models, "replica").read(line.stream, cast(StreamContext, context)))
    await until_true(lambda: line.stream.peer.held.num_bytes)
    before = taken[0]
    line.stream.refuse(hello_expected())
    goes_on = asyncio.create_task(context.is_waited_for.wait())
    await asyncio.wait({reading, goes_on}, return_when=asyncio.FIRST_COMPLETED)
    assert (reading.done(), taken[0] - before) == (True, 0)
    assert (line.stream.peer.held.num_bytes, Message.num_alive) == (0, 0)
    goes_on.cancel()
