"""The calls of one stream, one after another: each is watched, and when it is lost the next is made."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import convert
from motiongen_client.backoff import FINAL_CODES, Backoff
from motiongen_client.call import Call
from motiongen_client.channel import Route
from motiongen_client.errors import MotiongenError, OtherServer, ServerUnavailable, StreamLost
from motiongen_client.line_policy import LinePolicy
from motiongen_client.status import CREDENTIALS_EXPIRED, STARTING, STATUS_LOST

_log = logging.getLogger(__name__)

LAG_S = 1.0
_MOST_PINGS = 64
"""That are remembered until they are answered."""
LISTEN_S = (0.0, 0.1, 0.5, 2.0)
"""How long each of the calls in a row for one status listens before it says hello. A server that refuses a call does so
while the hello is still being written, and then grpc.aio loses the status: of 2 to 36 in 100 such calls, as the machine
has it. A call that says nothing meanwhile hears it for certain."""


@dataclass(frozen=True)
class CallEvents:
    """What a stream does when something becomes of its calls.

    take: with each response. greeted: once hellos were exchanged on a new channel, before the call counts as there.
    begun: a call is there. lost: it is gone; returns whether another is needed at once, else one is made when somebody
    waits for it. over: there will be none.
    """

    take: Callable[[service_pb2.StreamMotionResponse], None]
    greeted: Callable[[grpc.aio.Channel], Awaitable[None]]
    begun: Callable[[], None]
    lost: Callable[[], bool]
    over: Callable[[MotiongenError], None]


class Calls:
    """At most one call at a time, over a channel of its own, since what stopped one may be wrong with its connection.

    number: how many there were. reconnect_after_s: how long the server wants the next one to wait. other_servers: to
    which it sends the next one, the best first.
    """

    def __init__(
        self,
        connect: Callable[[], grpc.aio.Channel],
        address: str,
        agent: str,
        policy: LinePolicy,
        *,
        max_request_bytes: int,
        events: CallEvents,
        route: Route | None = None,
    ) -> None:
        """route: of the channels that `connect` makes; None: they all lead to one server."""
        self._route = route
        self._connect = connect
        self._address = address
        self._agent = agent
        self._policy = policy
        self._max_request_bytes = max_request_bytes
        self._events = events
        self._channel: grpc.aio.Channel | None = None
        self._call: Call | None = None
        self._closing = False
        self._news = asyncio.Event()  # the call is there, or gone, or never will be again
        self._ponged = asyncio.Event()
        self._wanted = asyncio.Event()
        self._watching: asyncio.Task[None] | None = None
        self._recovering: asyncio.Task[None] | None = None
        self._dropping: asyncio.Task[None] | None = None
        self._backoff = Backoff()
        self.failure: MotiongenError | None = None
        self.number = 0
        self.reconnect_after_s = 0.0
        self.other_servers: tuple[OtherServer, ...] = ()
        self.round_trip_s: float | None = None
        self._pinged_ns: deque[int] = deque(maxlen=_MOST_PINGS)  # when, of those without an answer

    @property
    def is_connected(self) -> bool:
        return self._call is not None

    @property
    def channel(self) -> grpc.aio.Channel | None:
        """That of the present call."""
        return self._channel

    @property
    def recovers(self) -> bool:
        """Whether a lost call is followed by another."""
        return self._policy.recover_s != 0 and not self._closing

    def send(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event. While there is no call it goes nowhere."""
        if self._call is not None:
            self._call.send(event)

    async def start(self) -> None:
        """Make the first call. Raises ServerUnavailable or StreamLost."""
        await self._make_call()
        self._watching = asyncio.create_task(self._watch(), name="motiongen-ping")

    async def close(self) -> None:
        """Finish the call, and make no other. May be called again."""
        self._closing = True
        tasks = [task for task in (self._watching, self._recovering) if task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self._call is not None:
            await self._call.close()
        self._end(StreamLost("CANCELLED", "the stream was closed here"))
        if self._dropping is not None:
            await asyncio.shield(self._dropping)

    def ask(self) -> None:
        """Have a call made where there is none. Does not wait for it."""
        self._wanted.set()

    async def until_connected(self) -> None:
        """Wait for a call. Raises why there will be none."""
        await self._until(lambda: self._call is not None and self.failure is None)

    async def until_after(self, number: int) -> None:
        """Wait for a call after the one of that number. Raises why there will be none."""
        await self._until(lambda: self.number > number)

    async def _until(self, holds: Callable[[], bool]) -> None:
        """Ask for a call, and wait until something holds of it. Raises why it never will."""
        while not holds():
            if self.failure is not None:
                raise self.failure
            self.ask()
            await self._news.wait()

    # ---- one call after another

    async def _make_call(self) -> None:
        """Raises ServerUnavailable or StreamLost, with what the server says of it."""
        for listen_s in LISTEN_S:
            try:
                return await self._try_call(listen_s)
            except StreamLost as lost:
                if lost.detail != STATUS_LOST or listen_s == LISTEN_S[-1]:
                    raise

    async def _try_call(self, listen_s: float) -> None:
        await self._drop_channel()
        self._check_open()
        channel = self._channel = self._connect()
        call = Call(channel, self._take, self._lose, self._max_request_bytes)
        try:
            await call.greet(self._agent, self._address, self._policy.hello_timeout_s, listen_s=listen_s)
            await self._events.greeted(channel)
            self._check_open()
        except BaseException:
            await call.close()
            raise
        if call.failure is not None:  # between the hello and now
            raise call.failure
        self._call = call
        self.number += 1
        self.reconnect_after_s, self.other_servers = 0.0, ()
        self._events.begun()
        self._tell()

    def _check_open(self) -> None:
        """Raise StreamLost where the stream was closed while a call was made."""
        if self._closing:
            raise StreamLost("CANCELLED", "the stream was closed here")

    async def _drop_channel(self) -> None:
        channel, self._channel = self._channel, None
        if channel is not None:
            await channel.close(None)

    def _lose(self, call: Call, failure: MotiongenError) -> None:
        """A call is over."""
        if call is not self._call:
            return  # it never came to be: whoever tries it knows
        self._call = None
        self._tell()
        is_final = not isinstance(failure, StreamLost) or failure.code in FINAL_CODES
        if isinstance(failure, StreamLost) and failure.reason == CREDENTIALS_EXPIRED:
            is_final = False  # where the next call has no better ones, it is refused for good
        if is_final or not self.recovers:
            self._end(failure, call)
            return
        why = f"{failure.code}: {failure.detail or 'no detail'}" if isinstance(failure, StreamLost) else str(failure)
        _log.warning("the connection to %s was lost (%s); connecting again", self._address, why)
        self._wanted.clear()
        if self._events.lost():
            self._wanted.set()
        self._recovering = asyncio.create_task(self._recover(failure), name="motiongen-recover")

    async def _recover(self, failure: MotiongenError) -> None:
        """Try for another call until there is one, or the time for it is over; at its end too, whatever was asked."""
        time, most_s = asyncio.get_running_loop().time, self._policy.recover_s
        await self._wanted.wait()  # a stream that carries nothing is ended by the server, for nothing
        began_s, asked_s = time(), self.reconnect_after_s
        if self._route is not None and self._route.follow(self.other_servers):
            asked_s = 0.0  # that is when the server itself is back
        while most_s is None or time() - began_s < most_s:
            delay_s = self._backoff.next_s(asked_s)
            await asyncio.sleep(delay_s if most_s is None else min(delay_s, began_s + most_s - time()))
            asked_s = 0.0
            try:
                await self._make_call()
                return
            except StreamLost as lost:
                failure = lost
                if lost.code in FINAL_CODES:
                    break
            except ServerUnavailable as unavailable:
                failure = StreamLost("UNAVAILABLE", unavailable.detail)
            except MotiongenError as violation:
                failure = violation
                break
            except Exception as fault:  # of what gives the token: its own line may be as lost as this one
                _log.warning("no call to %s can be made: %s", self._address, fault)
                failure = StreamLost("UNAVAILABLE", f"no call could be made: {fault}")
            if self._route is not None:
                self._route.pass_over(is_starting=isinstance(failure, StreamLost) and failure.reason == STARTING)
        self._end(failure)

    def _end(self, failure: MotiongenError, call: Call | None = None) -> None:
        """There will be no call any more, and nothing is left of the last one, whether `close` comes or not."""
        if self.failure is None:
            self.failure = failure
            self._events.over(failure)
            if self._watching is not None:
                self._watching.cancel()  # also where it is the one that has found the last call silent
            self._dropping = asyncio.get_running_loop().create_task(self._let_go(call), name="motiongen-drop")
        self._tell()

    async def _let_go(self, call: Call | None) -> None:
        if call is not None:
            await call.close()
        await self._drop_channel()

    def _tell(self) -> None:
        news, self._news = self._news, asyncio.Event()
        news.set()

    # ---- signs of life

    def _take(self, response: service_pb2.StreamMotionResponse) -> None:
        if (
            response.HasField("pong") and response.pong.client_time_ns in self._pinged_ns
        ):  # else it answers none of ours
            self._pinged_ns.remove(response.pong.client_time_ns)
            is_first = self.round_trip_s is None
            self.round_trip_s = asyncio.get_running_loop().time() - response.pong.client_time_ns / 1e9
            self._ponged.set()
            if is_first:
                self._send_ping()  # which tells it to the server
        self._events.take(response)

    async def _watch(self) -> None:
        """Ask for a sign of life again and again; a server that gives none is as good as gone."""
        policy, proved = self._policy, None
        while True:
            call = self._call
            if call is None:
                await self._news.wait()
                continue
            self._ponged.clear()
            self._send_ping()
            await asyncio.sleep(policy.pong_timeout_s)
            if not self._ponged.is_set():
                await asyncio.sleep(LAG_S)  # if it was we who stood still, what came meanwhile is read now
            if self._ponged.is_set():
                if call is proved:  # not by its first pong: something that we say may end every call at once
                    self._backoff.reset()
                proved = call
            elif call is self._call:
                call.give_up(StreamLost("UNAVAILABLE", f"no pong came within {policy.pong_timeout_s:g} s"))
            await asyncio.sleep(max(policy.ping_s - policy.pong_timeout_s, 0.0))

    def _send_ping(self) -> None:
        if self._call is not None:
            now_ns = int(asyncio.get_running_loop().time() * 1e9)
            self._pinged_ns.append(now_ns)
            self._call.ping(convert.ping(now_ns, self.round_trip_s))
