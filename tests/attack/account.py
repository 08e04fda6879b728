"""What a client was let do, and what that costs by the rules: a flood whose every message carries a ping.

A message is charged before its ping is answered, and nothing more is read of a stream that owes. So pings that are
answered are messages that were taken, and their cost over the time that it took is what the server truly gave: a busy
machine can only give less of it.
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
    """Messages that are alike. events: of the message of a number. cost: of one message, at least, in tokens.

    Costs are written down here once more, as `rpc/budgets/stream_budget.py` explains them, so that one that is lost
    there is noticed.
    """

    name: str
    events: Callable[[int], Sequence[session_pb2.SessionEvent]]
    cost: float
    opens: bool = False


def playheads(count: int) -> list[session_pb2.SessionEvent]:
    """Of a session that is not there, which are dropped unanswered."""
    return [Event(session=NO_SESSION, playhead=session_pb2.Playhead(frame=1, buffered_to=2))] * count


def paths(count: int, number: int) -> list[session_pb2.SessionEvent]:
    """An edit of the session that is there, to walk along so many paths."""
    path = motion_pb2.RootPath(positions=CORNERS)
    upsert = [motion_pb2.Constraint(constraint_id=n, root_path=path) for n in range(1, 1 + count)]
    return [Event(session=1, event_seq=2 + number, edit_constraints=session_pb2.EditConstraints(upsert=upsert))]


FLOODS = (
    Flood("nothing but pings", lambda number: (), cost=1.0),
    Flood("100 playheads", lambda number: playheads(100), cost=100.0),
    Flood("500 playheads, counted on the wire", lambda number: playheads(500), cost=500.0),
    Flood("20 empty events, which are refused", lambda number: [Event(session=NO_SESSION)] * 20, cost=20 * (1.0 + 9.0)),
    Flood("an edit of 5 paths", lambda number: paths(5, number), cost=1.0 + 5 * (3.0 + 50.0), opens=True),
)


@dataclass
class Given:
    """What a stream got. tokens: of whole messages, but for the newest, which may be owed for. seconds: it took."""

    tokens: float = 0.0
    seconds: float = 0.0
    lost: str = ""


async def flood(address: str, of: Flood, enough: Callable[[Given], bool]) -> Given:
    """Send without end, over a connection of its own, until enough was given or the stream has ended."""
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
