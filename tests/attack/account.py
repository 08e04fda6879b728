"""How much of its rate limit a flooding client is granted, in tokens. Every message of the flood carries a ping.

A message is charged before its ping is answered, and a stream in debt is not read. So an answered ping stands for an
accepted message, and the cost of these messages divided by the time is the rate that the server really granted: a busy
machine can only lower it.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import grpc.aio

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.calls import Event, Request, channel_to

NO_SESSION = 9
CORNERS = [0.0, 1.0]


@dataclass(frozen=True)
class Flood:
    """Messages of one kind. events: of a message, by its number. cost: the least cost of a message, in tokens.

    Costs are repeated here, as explained in `rpc/budgets/stream_budget.py`, so that it is noticed if the server stops
    charging one.
    """

    name: str
    events: Callable[[int], Sequence[session_pb2.SessionEvent]]
    cost: float
    opens: bool = False


def playheads(count: int) -> list[session_pb2.SessionEvent]:
    """Playheads of a session that does not exist, which are dropped without an answer."""
    return [Event(session=NO_SESSION, playhead=session_pb2.Playhead(frame=1, buffered_to=2))] * count


def paths(count: int, number: int) -> list[session_pb2.SessionEvent]:
    """An edit of the existing session, with so many paths."""
    path = motion_pb2.RootPath(positions=CORNERS)
    upsert = [motion_pb2.Constraint(constraint_id=n, root_path=path) for n in range(1, 1 + count)]
    return [Event(session=1, event_seq=2 + number, edit_constraints=session_pb2.EditConstraints(upsert=upsert))]


FLOODS = (
    Flood("pings only", lambda number: (), cost=1.0),
    Flood("100 playheads", lambda number: playheads(100), cost=100.0),
    Flood("500 playheads, counted before parsing", lambda number: playheads(500), cost=500.0),
    Flood("20 empty events, refused", lambda number: [Event(session=NO_SESSION)] * 20, cost=20 * (1.0 + 9.0)),
    Flood("an edit of 5 paths", lambda number: paths(5, number), cost=1.0 + 5 * (3.0 + 50.0), opens=True),
)


@dataclass
class Given:
    """What a stream was granted. tokens: of all messages but the newest, which may be unpaid. seconds: the time."""

    tokens: float = 0.0
    seconds: float = 0.0
    lost: str = ""


async def flood(address: str, of: Flood, enough: Callable[[Given], bool]) -> Given:
    """Send without end, over a new connection, until enough was granted or the stream has ended."""
    given, begun_s = Given(), time.monotonic()
    async with channel_to(address) as channel:
        call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
        opens = [Event(session=1, event_seq=1, open=session_pb2.OpenSession())] if of.opens else []
        await call.write(Request(hello=service_pb2.ClientHello(client_agent="flood"), events=opens))

        async def send() -> None:
            for number in itertools.count():
                await call.write(Request(ping=service_pb2.Ping(client_time_ns=1), events=of.events(number)))

        sending = asyncio.create_task(send())
        try:
            num_taken = 0
            while not enough(given) and isinstance(heard := await call.read(), service_pb2.StreamMotionResponse):
                if heard.HasField("pong"):
                    num_taken += 1
                    given.tokens, given.seconds = of.cost * (num_taken - 1), time.monotonic() - begun_s
            if not enough(given):
                given.lost = "the stream ended"
        except grpc.aio.AioRpcError as error:
            given.lost = f"{error.code().name}: {error.details()}"
        finally:
            sending.cancel()
            call.cancel()
            with contextlib.suppress(grpc.aio.AioRpcError, asyncio.CancelledError, asyncio.InvalidStateError):
                await sending
    return given
