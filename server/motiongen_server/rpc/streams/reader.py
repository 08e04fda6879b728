"""StreamReader: reads hello, pings and events from a stream, as fast as the stream can pay for them."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.errors import StreamRefused
from motiongen_server.models.registry import ModelRegistry
from motiongen_server.rpc.budgets.held_requests import Ended
from motiongen_server.rpc.budgets.stream_budget import EVENT_COST
from motiongen_server.rpc.convert import round_trip_s
from motiongen_server.rpc.errors.events import too_many_fields
from motiongen_server.rpc.errors.streams import (
    client_agent_too_long,
    hello_expected,
    hello_repeated,
    malformed,
)
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.request_parts import SMALL_BYTES, SMALL_EVENT_BYTES, TAKEN_APART, RequestParts, parsed
from motiongen_server.rpc.sparing_log import SparingLog
from motiongen_server.rpc.streams.goodbye import say_draining
from motiongen_server.rpc.streams.stream import Stream
from motiongen_server.rpc.wire_fields import Malformed

_log = logging.getLogger(__name__)

FLUSH_RANGE_S = (0.005, 0.1)
MAX_AGENT_CHARACTERS = 128
MAX_SHOWN_CHARACTERS = 160
"""Of an agent as written in the log, where an unprintable character takes up to ten."""
EVENTS_A_TURN = 64
EVENTS_A_WALK = 1024
"""Events of a long message that are counted before other streams have a turn."""
PARSED = 25
"""A small message is parsed as a whole, and then takes up to this many times its bytes, namely if all that it holds is
empty."""


class StreamReader:
    """Reads all streams of a service. ends_at: monotonic seconds, known once the server drains.

    reconnect_after_s: what clients are then told.
    """

    def __init__(self, models: ModelRegistry, replica_id: str, reconnect_after_s: float = 0.0) -> None:
        self._models = models
        self._replica_id = replica_id
        self._reconnect_after_s = reconnect_after_s
        self._log = SparingLog(_log)  # a client can begin a hundred streams a second
        self.ends_at: float | None = None

    async def read(self, stream: Stream, context: StreamContext) -> None:
        """Read until the client has finished. Raises StreamRefused if it violates the protocol."""
        while True:
            await stream.room()
            stream.listening_since = time.monotonic()
            data = await context.read()
            stream.listening_since = None
            if not isinstance(data, bytes):  # grpc.aio.EOF
                return
            now = time.monotonic()
            stream.budget.charge_message(len(data), now)
            refusal: StreamRefused | None = None
            stream.work.begin()
            try:
                await self._take(stream, data, now)
            except Ended:
                return
            except Malformed as error:
                refusal = malformed(str(error))
            except StreamRefused as error:
                refusal = error.with_traceback(None)  # the traceback would keep the message until it is collected
            finally:
                stream.work.end()
                del data  # otherwise it would be held until the next message comes
            if refusal is not None:
                raise refusal

    async def _take(self, stream: Stream, data: bytes, now: float) -> None:
        """Take one message. Raises Malformed, StreamRefused for what the stream does not allow now, and Ended."""
        if len(data) <= SMALL_BYTES:
            request = parsed(data)
            if events := request.events:
                stream.budget.charge(EVENT_COST * len(events), now)
            self._control(stream, request)
            if events and len(data) <= SMALL_EVENT_BYTES:
                await self._events(stream, events)
            elif events:
                with stream.peer.holding(stream, PARSED * len(data)):
                    await self._events(stream, events)
            return
        with stream.peer.holding(stream, TAKEN_APART * len(data)):
            await self._take_parts(stream, RequestParts(data, self._models.limits.max_event_fields))

    async def _take_parts(self, stream: Stream, parts: RequestParts) -> None:
        while not parts.is_done:
            stream.budget.charge(EVENT_COST * parts.walk(EVENTS_A_WALK), time.monotonic())
            await self._turn(stream)
        self._control(stream, parts.control())
        for request, is_overgrown in parts.events():
            await self._turn(stream)
            if is_overgrown:
                refusal = too_many_fields(self._models.limits.max_event_fields)
                stream.receive(request.events[0], time.monotonic(), refusal)
            else:
                await self._events(stream, request.events)

    @staticmethod
    async def _turn(stream: Stream) -> None:
        """Let others have a turn. Raises Ended if the stream was ended: the rest of its message is dropped at once."""
        stream.work.end()  # so that it is charged before the turn, which waits until it is paid
        try:
            stream.peer.bound_held()
            await stream.turn()
        finally:
            stream.work.begin()
        if stream.refusal is not None:
            raise Ended

    def _control(self, stream: Stream, request: service_pb2.StreamMotionRequest) -> None:
        """Take the part of a message that concerns the stream itself."""
        kind = request.WhichOneof("stream_event")
        if stream.greeted == (kind == "hello"):
            raise hello_expected() if not stream.greeted else hello_repeated()
        if kind == "hello":
            self._greet(stream, request.hello)
        elif kind == "ping":
            stream.rtt_s = round_trip_s(request.ping)
            pong = service_pb2.Pong(client_time_ns=request.ping.client_time_ns, server_time_ns=time.time_ns())
            stream.reply(service_pb2.StreamMotionResponse(pong=pong))

    async def _events(self, stream: Stream, events: Iterable[session_pb2.SessionEvent]) -> None:
        now, receive, budget = time.monotonic(), stream.receive, stream.budget
        charged = budget.charged
        for number, event in enumerate(events, 1):
            receive(event, now)
            # The events themselves were charged before; this counts the extra charges for expensive ones.
            if number % EVENTS_A_TURN == 0 or budget.charged - charged >= EVENTS_A_TURN:
                await self._turn(stream)
                charged = budget.charged

    def _greet(self, stream: Stream, hello: service_pb2.ClientHello) -> None:
        if len(hello.client_agent) > MAX_AGENT_CHARACTERS:
            raise client_agent_too_long(len(hello.client_agent), MAX_AGENT_CHARACTERS)
        self._log.info("stream %d begins, client %s", stream.number, _shown(hello.client_agent))
        if hello.HasField("flush_interval"):
            # Not with ToTimedelta, which fails for some of the Durations that a message can hold.
            asked = hello.flush_interval.seconds + hello.flush_interval.nanos / 1e9
            stream.flush_s = min(max(asked, FLUSH_RANGE_S[0]), FLUSH_RANGE_S[1])
        answer = service_pb2.ServerHello(
            replica_id=self._replica_id, limits=self._models.limits_message, server_time_ns=time.time_ns()
        )
        stream.reply(service_pb2.StreamMotionResponse(hello=answer))
        stream.greeted = True
        if self.ends_at is not None:
            grace_s = self.ends_at - time.monotonic()
            say_draining(stream, self._models.default.model_id, grace_s, self._reconnect_after_s)


def _shown(agent: str) -> str:
    shown = repr(agent)
    return shown if len(shown) <= MAX_SHOWN_CHARACTERS else f"{shown[: MAX_SHOWN_CHARACTERS - 3]}..."
