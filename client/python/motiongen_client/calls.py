"""Calls: makes the calls of one stream, one at a time, watches each, and makes the next when one is lost."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable

import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import convert
from motiongen_client.backlog import SendQueue
from motiongen_client.backoff import FINAL_CODES, Backoff
from motiongen_client.call import Call
from motiongen_client.call_events import CallEvents
from motiongen_client.channel import Route
from motiongen_client.errors import MotiongenError, OtherServer, ServerUnavailable, StreamLost
from motiongen_client.line_policy import LinePolicy
from motiongen_client.status import CREDENTIALS_EXPIRED, STARTING, STATUS_LOST

_log = logging.getLogger(__name__)

LAG_S = 1.0
_MOST_PINGS = 64
"""Limit on the unanswered pings that are remembered."""
LISTEN_S = (0.0, 0.1, 0.5, 2.0)
"""How long successive attempts at a call listen before they send the hello. A server may refuse a call while the hello
is still being written; grpc.aio then loses the status, in 2 to 36 of 100 such calls, depending on the machine. A call
that writes nothing until it has listened always receives it."""


class Calls:
    """At most one call at a time, each over its own channel, since a bad connection may be what ended the last.

    number: how many calls there were. reconnect_after_s: how long the server asked the client to wait before the next.
    other_servers: where the server sends the next call, best first.
    """

    def __init__(
        self,
        connect: Callable[[], grpc.aio.Channel],
        address: str,
        agent: str,
        policy: LinePolicy,
        *,
        make_queue: Callable[[], SendQueue],
        events: CallEvents,
        route: Route | None = None,
    ) -> None:
        """make_queue: makes a queue for each call. route: decides where `connect` leads; None: always to one server."""
        self._route = route
        self._connect = connect
        self._address = address
        self._agent = agent
        self._policy = policy
        self._make_queue = make_queue
        self._events = events
        self._channel: grpc.aio.Channel | None = None
        self._call: Call | None = None
        self._closing = False
        self._news = asyncio.Event()  # set when a call begins, is lost, or there will be none
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
        self._pinged_ns: deque[int] = deque(maxlen=_MOST_PINGS)  # send times of unanswered pings

    @property
    def is_connected(self) -> bool:
        return self._call is not None

    @property
    def channel(self) -> grpc.aio.Channel | None:
        """The channel of the present call."""
        return self._channel

    @property
    def recovers(self) -> bool:
        """Whether a lost call is followed by another."""
        return self._policy.recover_s != 0 and not self._closing

    def send(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event. It is dropped while there is no call."""
        if self._call is not None:
            self._call.send(event)

    async def start(self) -> None:
        """Make the first call. Raises ServerUnavailable or StreamLost."""
        await self._make_call()
        self._watching = asyncio.create_task(self._watch(), name="motiongen-ping")

    async def close(self) -> None:
        """Finish the call and make no other. May be called again."""
        self._closing = True
        tasks = [task for task in (self._watching, self._recovering) if task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self._call is not None:
            await self._call.close()
        self._end(_closed_here())
        if self._dropping is not None:
            await asyncio.shield(self._dropping)

    def ask(self) -> None:
        """Have a call made if there is none. Does not wait for it."""
        self._wanted.set()

    async def until_connected(self) -> None:
        """Wait for a call. Raises the failure if there will be none."""
        await self._until(lambda: self._call is not None and self.failure is None)

    async def until_after(self, number: int) -> None:
        """Wait for a call later than the one of that number. Raises the failure if there will be none."""
        await self._until(lambda: self.number > number)

    async def is_lost(self, number: int) -> bool:
        """Whether the call of that number is gone, or turns out to be within a moment. Raises the failure as above.

        Other requests to the same server may fail a little before its loss is noticed here.
        """
        try:
            async with asyncio.timeout(LAG_S):
                await self._until(lambda: self.number > number or self._call is None)
        except TimeoutError:
            return False
        return True

    async def _until(self, holds: Callable[[], bool]) -> None:
        """Ask for a call, and wait until a condition holds. Raises the failure if it never will."""
        while not holds():
            if self.failure is not None:
                raise self.failure
            self.ask()
            await self._news.wait()

    # ---- one call after another

    async def _make_call(self) -> None:
        """Make a call. Raises ServerUnavailable or StreamLost, with the status that the server gave if any."""
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
        call = Call(channel, self._take, self._lose, self._make_queue())
        try:
            await call.greet(self._agent, self._address, self._policy.hello_timeout_s, listen_s=listen_s)
            await self._events.greeted(channel)
            self._check_open()
        except BaseException:
            await call.close()
            raise
        if call.failure is not None:  # it was lost after the hello
            raise call.failure
        self._call = call
        self.number += 1
        self.reconnect_after_s, self.other_servers = 0.0, ()
        self._events.begun()
        self._tell()

    def _check_open(self) -> None:
        """Raise StreamLost if the stream was closed while the call was being made."""
        if self._closing:
            raise _closed_here()

    async def _drop_channel(self) -> None:
        channel, self._channel = self._channel, None
        if channel is not None:
            await channel.close(None)

    def _lose(self, call: Call, failure: MotiongenError) -> None:
        """Handle the end of a call: end the stream, or start to recover."""
        if call is not self._call:
            return  # it was never established: `_try_call` raises its failure
        self._call = None
        self._tell()
        is_final = not isinstance(failure, StreamLost) or failure.code in FINAL_CODES
        if isinstance(failure, StreamLost) and failure.reason == CREDENTIALS_EXPIRED:
            is_final = False  # the next call may carry renewed ones; if not, it is refused for good
        if is_final or not self.recovers:
            self._end(_closed_here() if self._closing else failure, call)
            return
        why = f"{failure.code}: {failure.detail or 'no detail'}" if isinstance(failure, StreamLost) else str(failure)
        _log.warning("the connection to %s was lost (%s); reconnecting", self._address, why)
        self._wanted.clear()
        if self._events.lost():
            self._wanted.set()
        self._recovering = asyncio.create_task(self._recover(failure), name="motiongen-recover")

    async def _recover(self, failure: MotiongenError) -> None:
        """Try to make a call until one is there or recover_s is over. The last try is then, whatever wait was asked."""
        time, most_s = asyncio.get_running_loop().time, self._policy.recover_s
        await self._wanted.wait()  # servers end calls without sessions, so none is made before it is needed
        began_s, asked_s = time(), self.reconnect_after_s
        if self._route is not None and self._route.follow(self.other_servers):
            asked_s = 0.0  # that wait is for the return of the lost server
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
            except Exception as fault:  # of the token function, whose own network may be down too
                _log.warning("no call to %s can be made: %s", self._address, fault)
                failure = StreamLost("UNAVAILABLE", f"no call could be made: {fault}")
            if self._route is not None:
                self._route.pass_over(is_starting=isinstance(failure, StreamLost) and failure.reason == STARTING)
        self._end(failure)

    def _end(self, failure: MotiongenError, call: Call | None = None) -> None:
        """End for good, and release the last call and its channel, even if `close` is never called."""
        if self.failure is None:
            self.failure = failure
            self._events.over(failure)
            if self._watching is not None:
                self._watching.cancel()  # even if it is the watcher itself that calls this
            self._dropping = asyncio.get_running_loop().create_task(self._let_go(call), name="motiongen-drop")
        self._tell()

    async def _let_go(self, call: Call | None) -> None:
        if call is not None:
            await call.close()
        await self._drop_channel()

    def _tell(self) -> None:
        news, self._news = self._news, asyncio.Event()
        news.set()

    # ---- pings

    def _take(self, response: service_pb2.StreamMotionResponse) -> None:
        if (
            response.HasField("pong") and response.pong.client_time_ns in self._pinged_ns
        ):  # otherwise it answers none of ours
            self._pinged_ns.remove(response.pong.client_time_ns)
            is_first = self.round_trip_s is None
            self.round_trip_s = asyncio.get_running_loop().time() - response.pong.client_time_ns / 1e9
            self._ponged.set()
            if is_first:
                self._send_ping()  # which reports the round trip to the server
        self._events.take(response)

    async def _watch(self) -> None:
        """Ping the server regularly, and give up a call without a pong."""
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
                await asyncio.sleep(LAG_S)  # if this process was stalled, responses that arrived meanwhile are read now
            if self._ponged.is_set():
                if call is proved:  # at the second pong: what this client sends may end each call early
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


def _closed_here() -> StreamLost:
    return StreamLost("CANCELLED", "the stream was closed here")
