"""Call: one call to the server. It writes queued events, passes responses on, and reports its end.

This file keeps to the following rules of grpc.aio:

- A read or write in flight is never cancelled or put under a timeout, since its native batch would leak. The read and
  write loops end because the call ends.
- Every call is cancelled at last, since an abandoned one is never collected, and is read to its end: after a failed
  write it counts as over and can no longer be cancelled, while earlier messages still wait to be read.
- Nothing is written before there is a connection. A write that waits for one is not told that the call was cancelled,
  and waits for ever if a server accepts connections and says nothing.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TypeAlias

import grpc
import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_client.backlog import SendQueue
from motiongen_client.errors import MotiongenError, ProtocolViolation, ServerUnavailable, StreamLost
from motiongen_client.status import reason_of

_log = logging.getLogger(__name__)

_Call: TypeAlias = "grpc.aio.StreamStreamCall[service_pb2.StreamMotionRequest, service_pb2.StreamMotionResponse]"

CLOSE_GRACE_S = 5.0

Take: TypeAlias = Callable[[service_pb2.StreamMotionResponse], None]


class Call:
    """One StreamMotion call: first `greet`, then `send`. `on_end` is called once, when it is over for any reason.

    take: called with every response; may raise ProtocolViolation, which ends the call. queue: its own.
    """

    def __init__(
        self,
        channel: grpc.aio.Channel,
        take: Take,
        on_end: Callable[[Call, MotiongenError], None],
        queue: SendQueue,
    ) -> None:
        self._channel = channel
        self._take = take
        self._on_end = on_end
        self._queue = queue
        self._something_to_send = asyncio.Event()
        self._hello = asyncio.Event()
        self._is_closing = False
        self._failure: MotiongenError | None = None
        self._call: _Call | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._connecting: asyncio.Task[None] | None = None

    async def greet(self, agent: str, address: str, timeout_s: float, *, listen_s: float = 0.0) -> None:
        """Make the call and exchange hellos. Raises ServerUnavailable or StreamLost; call `close` then.

        listen_s: how long to wait for a refusal before anything is written.
        """
        call: _Call = MotionServiceStub(self._channel).StreamMotion()
        self._call = call
        reading = asyncio.create_task(self._read(call), name="motiongen-read")
        self._connecting = asyncio.create_task(self._connect(call, reading, listen_s), name="motiongen-connect")
        hello = service_pb2.ClientHello(client_agent=agent)
        writing = asyncio.create_task(self._write(call, self._connecting, hello), name="motiongen-write")
        self._tasks = [reading, writing]
        greeted = asyncio.create_task(self._hello.wait(), name="motiongen-hello")
        try:
            await asyncio.wait({reading, greeted}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            greeted.cancel()
        if not self._hello.is_set():
            raise self._failure or ServerUnavailable(address, f"no hello came within {timeout_s} s")

    @property
    def failure(self) -> MotiongenError | None:
        """Why it is over; None while it is not."""
        return self._failure

    def send(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event; it goes out with the next message."""
        self._queue.put(event)
        self._something_to_send.set()

    def ping(self, ping: service_pb2.Ping) -> None:
        """Send a ping with the next message."""
        self._queue.put_ping(ping)
        self._something_to_send.set()

    def give_up(self, failure: MotiongenError) -> None:
        """The other side does not answer: end the call as lost."""
        self._end(failure)

    async def close(self) -> None:
        """Finish writing, let the server end what is open, and end the call. May be called again."""
        self._is_closing = True
        self._something_to_send.set()
        if self._hello.is_set() and self._failure is None:
            await asyncio.wait(self._tasks, timeout=CLOSE_GRACE_S)
        if self._call is not None:
            self._call.cancel()
        if self._connecting is not None:
            self._connecting.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _end(self, failure: MotiongenError) -> None:
        if self._failure is not None:
            return
        self._failure = failure
        self._queue.clear()
        self._something_to_send.set()  # lets the write loop see that it is over
        if self._call is not None:
            self._call.cancel()
        self._on_end(self, failure)

    async def _read(self, call: _Call) -> None:
        failure: MotiongenError
        try:
            async for response in call:  # read to the end: unread messages would keep the connection open
                if self._failure is None:  # otherwise the call was given up, and another has replaced it
                    self._hear(response)
            failure = StreamLost("OK", "the server ended the stream")
        except grpc.aio.AioRpcError as error:
            failure = StreamLost(error.code().name, error.details() or "", reason_of(error))
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if task is not None and task.cancelling() and not self._is_closing and self._failure is None:
                raise
            failure = StreamLost("CANCELLED", "the stream was closed here")  # grpc.aio reports a closed channel so
        self._end(failure)

    def _hear(self, response: service_pb2.StreamMotionResponse | None) -> None:
        if response is None:  # grpc.aio could not parse it
            self._end(StreamLost("INTERNAL", "the server sent something that is not a message"))
            return
        if response.HasField("hello"):
            self._hello.set()
        try:
            self._take(response)
        except ProtocolViolation as violation:
            _log.error("%s; giving the stream up", violation)
            self._end(violation)
        except Exception as fault:  # an unforeseen response; unlogged, it would pass for a lost connection
            failure = ProtocolViolation(f"a response of the server cannot be processed: {fault!r}")
            _log.exception("%s; giving the stream up", failure)
            self._end(failure)

    @staticmethod
    async def _connect(call: _Call, reading: asyncio.Task[None], listen_s: float) -> None:
        """Wait until something may be written."""
        await call.wait_for_connection()
        if listen_s:
            await asyncio.wait({reading}, timeout=listen_s)

    async def _write(self, call: _Call, connecting: asyncio.Task[None], hello: service_pb2.ClientHello) -> None:
        try:
            await connecting
            await call.write(service_pb2.StreamMotionRequest(hello=hello))
            while self._failure is None:
                await self._something_to_send.wait()
                self._something_to_send.clear()
                while self._failure is None and self._queue:
                    await call.write(self._queue.take())
                if self._is_closing:
                    await call.done_writing()
                    return
        except (grpc.aio.AioRpcError, asyncio.InvalidStateError):
            pass  # the call is over; the read loop learns why
        except asyncio.CancelledError:
            if self._failure is None and not self._is_closing:
                raise
