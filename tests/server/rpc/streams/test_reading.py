"""When a stream is read further: not while too many answers wait for its client, but always once it has ended."""

from __future__ import annotations

import asyncio
import itertools
import time
from typing import cast

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.engine.types import Code, Outcome, SessionKey
from motiongen_server.rpc.budgets.stream_budget import BYTES_A_TOKEN, EVENT_COST, MESSAGE_COST
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.streams.output import MAX_WAITING_REPLIES
from motiongen_server.rpc.streams.reader import StreamReader
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, Line, make_catalog

PONG = service_pb2.StreamMotionResponse(pong=service_pb2.Pong(client_time_ns=1))
ROUNDS = 10


async def is_waiting(task: asyncio.Task[None]) -> bool:
    for _ in range(ROUNDS):
        await asyncio.sleep(0)  # one iteration of the event loop; nothing here depends on time
    return not task.done()


@pytest.fixture
async def line() -> Line:
    return Line(make_catalog(hard_backlog_bytes=1_000))


async def test_stream_is_read_while_its_client_reads(line: Line) -> None:
    assert not await is_waiting(asyncio.create_task(line.stream.room()))


async def test_unread_answers_stop_reading_until_they_are_read(line: Line) -> None:
    for number in range(4):
        line.stream.take(Outcome(SessionKey(1, 5), number, Code.NOT_FOUND, reason="R", message="m" * 300))
    reading = asyncio.create_task(line.stream.room())
    assert await is_waiting(reading)
    assert line.stream.next_response() is not None
    assert not await is_waiting(reading)


async def test_unread_pongs_stop_reading_until_they_are_read(line: Line) -> None:
    for _ in range(MAX_WAITING_REPLIES + 1):
        line.stream.reply(PONG)
    reading = asyncio.create_task(line.stream.room())
    assert await is_waiting(reading)
    line.stream.next_response()
    assert not await is_waiting(reading)


async def test_end_of_the_stream_ends_the_wait(line: Line) -> None:
    for _ in range(MAX_WAITING_REPLIES + 1):
        line.stream.reply(PONG)
    reading = asyncio.create_task(line.stream.room())
    assert await is_waiting(reading)
    line.stream.end()
    assert not await is_waiting(reading)


async def test_stream_in_debt_is_not_read_until_it_has_paid(monkeypatch: pytest.MonkeyPatch) -> None:
    monotonic, leapt_s = time.monotonic, [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: monotonic() + leapt_s[0])  # the event loop's clock too
    line = Line(make_catalog(stream_events_per_second=1.0))
    line.stream.budget.charge(3601.0, time.monotonic())  # an hour, and the second that it may use at once
    reading = asyncio.create_task(line.stream.room())
    assert await is_waiting(reading)
    leapt_s[0] += 1800.0
    assert await is_waiting(reading), "half of it is paid"
    leapt_s[0] += 1800.0
    assert not await is_waiting(reading)


async def test_two_refusals_put_a_stream_of_ten_events_a_second_in_debt() -> None:
    line = Line(make_catalog(stream_events_per_second=10.0))
    line.send(5, set_play_state=session_pb2.SetPlayState())
    now = time.monotonic()
    assert line.stream.budget.owed_s(now) == 0
    line.send(5, set_play_state=session_pb2.SetPlayState())
    assert line.stream.budget.owed_s(now) > 0


class Client:
    """Sends messages. charged: what its stream had been charged before each message, and before the end."""

    def __init__(self, line: Line, *said: service_pb2.StreamMotionRequest) -> None:
        self.charged: list[float] = []
        self._line, self._said = line, iter(said)

    async def read(self) -> object:
        self.charged.append(self._line.stream.budget.charged)
        said = next(self._said, None)
        return grpc.aio.EOF if said is None else said.SerializeToString()


async def test_refused_event_is_charged_ten_times_as_much_as_an_accepted_one() -> None:
    line = Line()
    line.open()
    accepted, refused = (
        session_pb2.SessionEvent(session=HANDLE, event_seq=seq, set_play_state=PAUSE) for seq in (2, 9)
    )
    hello = service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello())
    client = Client(line, hello, *(service_pb2.StreamMotionRequest(events=[each]) for each in (accepted, refused)))
    await StreamReader(line.models, "replica").read(line.stream, cast(StreamContext, client))
    assert line.refusals() == [(9, "SEQUENCE_GAP")]
    _, *costs = (after - before for before, after in itertools.pairwise(client.charged))
    message = MESSAGE_COST + (accepted.ByteSize() + 2) / BYTES_A_TOKEN
    assert costs == [message + EVENT_COST, message + 10 * EVENT_COST]
