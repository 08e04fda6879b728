"""What a stream is charged for what is read from it, what is held meanwhile, and when its client is listened to."""

from __future__ import annotations

import asyncio
import time
from itertools import pairwise
from typing import cast

import grpc.aio
import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.budgets.stream_budget import BYTES_A_TOKEN, EVENT_COST, MESSAGE_COST
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.request_parts import FIELDS_A_PART, SMALL_BYTES, SMALL_EVENT_BYTES, TAKEN_APART
from motiongen_server.rpc.streams.reader import EVENTS_A_TURN, EVENTS_A_WALK, PARSED, StreamReader
from tests.server.rpc.streams.test_event_order import Line
from tests.waiting import LIMIT_S

HELLO = service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()).SerializeToString()
PING = service_pb2.StreamMotionRequest(ping=service_pb2.Ping()).SerializeToString()


def message_of(num_events: int) -> bytes:
    playhead = session_pb2.SessionEvent(session=1, playhead=session_pb2.Playhead(frame=7))
    return service_pb2.StreamMotionRequest(events=[playhead] * num_events).SerializeToString()


FIELDS = 400
FULL = service_pb2.StreamMotionRequest(
    events=[
        session_pb2.SessionEvent(
            session=1, edit_constraints=session_pb2.EditConstraints(upsert=[motion_pb2.Constraint()] * FIELDS)
        )
    ]
    * 40
).SerializeToString()
SOME, MANY, LONG = message_of(3), message_of(SMALL_EVENT_BYTES // 4), message_of(2 * EVENTS_A_WALK)


class Reading:
    """A stream that is read to its end.

    listened: at each read, whether its client was listened to; taken: the same at each event that was taken; held: how
    many bytes were held then, for its peer; turns: how many events had been taken at each turn of others. cost: what is
    charged for an event beside what it costs to be read.
    """

    def __init__(self, *messages: bytes) -> None:
        self.line = Line()
        self.stream = self.line.stream
        self.stream.peer.num_streams = 1
        self.listened: list[bool] = []
        self.taken: list[bool] = []
        self.held: list[int] = []
        self.turns: list[int] = []
        self.cost = 0.0
        self._messages = list(messages)
        self.stream.owed_s = lambda now: 0.0  # type: ignore[method-assign]  # it has no budget to wait for
        self.stream.receive = self._take  # type: ignore[method-assign]
        self.stream.turn = self._turn  # type: ignore[method-assign]

    def _take(self, *_: object) -> None:
        self._note(self.taken)
        self.held.append(self.stream.peer.held.num_bytes)
        self.stream.budget.charge(self.cost, time.monotonic())

    async def _turn(self) -> None:
        self.turns.append(len(self.taken))

    def _note(self, notes: list[bool]) -> None:
        notes.append(self.stream.listening_since is not None)

    async def read(self) -> object:
        self._note(self.listened)
        return self._messages.pop(0) if self._messages else grpc.aio.EOF

    async def to_the_end(self) -> None:
        async with asyncio.timeout(LIMIT_S):
            await StreamReader(self.line.models, "replica").read(self.stream, cast(StreamContext, self))


@pytest.mark.parametrize(
    ("message", "num_events"),
    [(PING, 0), (SOME, 3), (MANY, SMALL_EVENT_BYTES // 4), (LONG, 2 * EVENTS_A_WALK)],
    ids=["a ping", "some events", "many events", "a long message"],
)
async def test_a_message_is_charged_for_itself_its_bytes_and_its_events(message: bytes, num_events: int) -> None:
    assert len(SOME) < SMALL_EVENT_BYTES < len(MANY) < SMALL_BYTES < len(LONG)
    reading = Reading(HELLO, message)
    await reading.to_the_end()
    num_bytes = len(HELLO) + len(message)
    assert reading.stream.budget.charged == 2 * MESSAGE_COST + num_bytes / BYTES_A_TOKEN + EVENT_COST * num_events
    assert len(reading.taken) == num_events


async def test_client_counts_as_silent_between_messages_but_not_while_one_is_processed() -> None:
    """Otherwise a client would be ended as silent while the server reads, or waits for payment of, what it has said."""
    reading = Reading(HELLO, SOME, LONG)
    await reading.to_the_end()
    assert reading.listened == [True] * 4
    assert set(reading.taken) == {False}
    assert reading.stream.listening_since is None


@pytest.mark.parametrize(
    ("message", "times"), [(SOME, 0), (MANY, PARSED), (LONG, TAKEN_APART)], ids=["short", "longer", "long"]
)
async def test_memory_of_a_message_counts_for_its_peer_while_it_is_processed(message: bytes, times: int) -> None:
    reading = Reading(HELLO, message)
    await reading.to_the_end()
    assert set(reading.held) == {times * len(message)}
    assert reading.stream.peer.held.num_bytes == 0


@pytest.mark.parametrize(
    ("message", "first", "most"),
    [(MANY, 0, EVENTS_A_TURN), (LONG, 2 + 1, EVENTS_A_TURN), (FULL, 1 + 1, FIELDS_A_PART // FIELDS)],
    ids=["a short message", "many events", "many fields"],
)
async def test_event_loop_serves_others_while_a_message_is_counted_and_processed(
    message: bytes, first: int, most: int
) -> None:
    """first: turns before anything of it is taken; most: events between turns."""
    reading = Reading(HELLO, message)
    await reading.to_the_end()
    assert reading.turns.count(0) == first
    between = [*reading.turns, len(reading.taken)]
    assert max(later - earlier for earlier, later in pairwise([0, *between])) == most


async def test_event_loop_serves_others_after_an_expensive_event() -> None:
    reading = Reading(HELLO, SOME)
    reading.cost = float(EVENTS_A_TURN)
    await reading.to_the_end()
    assert reading.turns == [1, 2, 3]


async def test_control_fields_of_a_long_message_are_processed() -> None:
    reading = Reading(HELLO, SOME, PING + LONG)
    await reading.to_the_end()
    assert [each.WhichOneof("stream_event") for each in reading.stream.responses] == ["hello", "pong"]
    early = Reading(LONG)
    with pytest.raises(StreamRefused, match="hello"):
        await early.to_the_end()
    assert early.taken == []
