"""The transport: one call to the server that carries any number of sessions.

What grpc.aio asks for, kept here in one place: a read or write in flight is never cancelled or put under a timeout
(its native batch would leak), so the two loops end because the call ends; and a call is always cancelled at last (an
abandoned one is never collected). Tasks that touch no call are cancelled as usual.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import grpc
import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_client import convert
from motiongen_client.errors import (
    EventRefused,
    InvalidInput,
    MotiongenError,
    ProtocolViolation,
    ServerUnavailable,
    StreamLost,
)
from motiongen_client.prompts import Prompt
from motiongen_client.session import Session
from motiongen_client.types import NO_PROMPTS, Catalog, Constraint, SessionOptions

_log = logging.getLogger(__name__)

_Call: TypeAlias = "grpc.aio.StreamStreamCall[service_pb2.StreamMotionRequest, service_pb2.StreamMotionResponse]"

_PING_PERIOD_S = 10.0  # below the idle limit of every common proxy
_MIN_REPORT_GAP_S = 0.025  # 40 a second; servers allow 50 events of a session
_CLOSE_GRACE_S = 5.0


class Stream:
    """One call to the server, with its sessions. Made by `MotionClient.stream`; use it as `async with`.

    report_hz: how often the server hears the playheads, which are its clock and its credit.
    """

    def __init__(
        self,
        stub: MotionServiceStub,
        address: str,
        catalog: Catalog,
        agent: str,
        *,
        report_hz: float = 4.0,
        hello_timeout_s: float = 10.0,
    ) -> None:
        if not 1 <= report_hz <= 5:
            raise InvalidInput("report_hz", report_hz, "a number from 1 to 5")
        self._stub = stub
        self._address = address
        self._catalog = catalog
        self._agent = agent
        self._report_period_s = 1 / report_hz
        self._hello_timeout_s = hello_timeout_s
        self._sessions: dict[int, Session] = {}
        self._next_handle = 1
        self._send_queue: list[session_pb2.SessionEvent] = []
        self._ping: service_pb2.Ping | None = None
        self._something_to_send = asyncio.Event()
        self._report_wanted = asyncio.Event()
        self._hello = asyncio.Event()
        self._closing = False
        self._failure: MotiongenError | None = None
        self._call: _Call | None = None
        self._call_tasks: list[asyncio.Task[None]] = []
        self._timer_tasks: list[asyncio.Task[None]] = []
        self.replica_id = ""
        self.draining = False
        self.round_trip_s: float | None = None

    @property
    def sessions(self) -> tuple[Session, ...]:
        """The sessions that live on this stream."""
        return tuple(self._sessions.values())

    async def open(
        self,
        prompt: Prompt | None = None,
        *,
        later_prompts: Mapping[int, Prompt] = NO_PROMPTS,
        options: SessionOptions | None = None,
        constraints: Sequence[Constraint] = (),
        keep_s: float | None = 60.0,
    ) -> Session:
        """Make a character, directed by a prompt and constraints from its first frame on.

        later_prompts: prompts by the frame at which each takes over, as `set_prompt` with a frame schedules them.
        keep_s: how many seconds of motion behind the playhead stay readable; None keeps all.
        Raises EventRefused when the server refuses it, StreamLost when the stream is gone.
        """
        if self._failure is not None:
            raise self._failure
        options = options or SessionOptions()
        if options.model_id and not any(model.model_id == options.model_id for model in self._catalog.models):
            await self._fetch_catalog()
        try:
            return await self._open(options, prompt, later_prompts, constraints, keep_s)
        except EventRefused as refusal:
            if options.model_id or refusal.reason != "UNKNOWN_MODEL":
                raise
        await self._fetch_catalog()  # the default was unloaded since
        return await self._open(options, prompt, later_prompts, constraints, keep_s)

    async def _open(
        self,
        options: SessionOptions,
        prompt: Prompt | None,
        later_prompts: Mapping[int, Prompt],
        constraints: Sequence[Constraint],
        keep_s: float | None,
    ) -> Session:
        if not options.model_id and self._catalog.models:  # the default of the catalogue that its rig is looked up in
            options = replace(options, model_id=self._catalog.models[0].model_id)
        session = Session(self._next_handle, self, self._catalog, asyncio.get_running_loop().time)
        self._next_handle += 1
        self._sessions[session.handle] = session
        try:
            await session._open(options, prompt, later_prompts, constraints, keep_s)
        except MotiongenError:
            self._sessions.pop(session.handle, None)
            raise
        return session

    async def _fetch_catalog(self) -> None:
        """The server may have loaded and unloaded models since the client connected."""
        request = service_pb2.GetCatalogRequest()
        try:
            self._catalog = convert.catalog(await self._stub.GetCatalog(request, timeout=self._hello_timeout_s))
        except grpc.aio.AioRpcError as error:
            raise ServerUnavailable(self._address, f"{error.code().name}, {error.details()}") from None

    async def start(self) -> Stream:
        """Make the call and exchange hellos. `async with` does it. Raises ServerUnavailable or StreamLost."""
        self._call = self._stub.StreamMotion()
        hello = service_pb2.ClientHello(client_agent=self._agent)
        reading = asyncio.create_task(self._read(self._call), name="motiongen-read")
        writing = asyncio.create_task(self._write(self._call, hello), name="motiongen-write")
        self._call_tasks = [reading, writing]
        greeted = asyncio.create_task(self._hello.wait(), name="motiongen-hello")
        await asyncio.wait({reading, greeted}, timeout=self._hello_timeout_s, return_when=asyncio.FIRST_COMPLETED)
        greeted.cancel()
        if not self._hello.is_set():
            failure = self._failure
            await self.close()
            if failure is not None:
                raise failure
            raise ServerUnavailable(self._address, f"no hello came within {self._hello_timeout_s} s")
        self._timer_tasks = [
            asyncio.create_task(self._report_playheads(), name="motiongen-report"),
            asyncio.create_task(self._send_pings(), name="motiongen-ping"),
        ]
        return self

    async def close(self) -> None:
        """End all sessions and the call. May be called again."""
        self._closing = True
        for timer in self._timer_tasks:
            timer.cancel()
        await asyncio.gather(*self._timer_tasks, return_exceptions=True)
        self._something_to_send.set()
        if self._call_tasks and self._hello.is_set():
            await asyncio.wait(self._call_tasks, timeout=_CLOSE_GRACE_S)
        if self._call is not None:
            self._call.cancel()
        await asyncio.gather(*self._call_tasks, return_exceptions=True)

    async def __aenter__(self) -> Stream:
        return await self.start()

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    # ---- for the sessions

    def send(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event; it goes out with the next message. Raises InvalidInput when it is too big for one."""
        if event.ByteSize() > self._max_batch_bytes:
            allowed = f"at most {self._max_batch_bytes} bytes in one event; split it"
            raise InvalidInput(event.WhichOneof("event") or "event", f"{event.ByteSize()} bytes", allowed)
        self._send_queue.append(event)
        self._something_to_send.set()

    def report_soon(self) -> None:
        """Report playheads without waiting for the next regular report."""
        self._report_wanted.set()

    @property
    def _max_batch_bytes(self) -> int:
        return self._catalog.limits.max_request_bytes * 9 // 10  # the rest is for the message around the events

    # ---- the two loops of the call

    async def _read(self, call: _Call) -> None:
        failure: MotiongenError
        try:
            while isinstance(response := await call.read(), service_pb2.StreamMotionResponse):  # else the end of it
                self._take(response)
            failure = StreamLost("OK", "the server ended the stream")
        except grpc.aio.AioRpcError as error:
            failure = StreamLost(error.code().name, error.details() or "")
        except ProtocolViolation as violation:
            failure = violation
            _log.error("%s; giving the stream up", violation)
        except asyncio.CancelledError:
            if not self._closing:
                raise
            failure = StreamLost("CANCELLED", "the stream was closed here")
        self._failure = failure
        for session in self._sessions.values():
            session._fail(failure)
        self._sessions.clear()
        self._something_to_send.set()  # lets the write loop see that it is over
        call.cancel()

    async def _write(self, call: _Call, hello: service_pb2.ClientHello) -> None:
        try:
            await call.write(service_pb2.StreamMotionRequest(hello=hello))
            while self._failure is None:
                await self._something_to_send.wait()
                self._something_to_send.clear()
                while self._failure is None and (self._send_queue or self._ping is not None):
                    await call.write(self._next_request())
                if self._closing:
                    await call.done_writing()
                    return
        except (grpc.aio.AioRpcError, asyncio.InvalidStateError):
            pass  # the call is over; the read loop learns why and tells the sessions
        except asyncio.CancelledError:
            if self._failure is None and not self._closing:
                raise

    def _next_request(self) -> service_pb2.StreamMotionRequest:
        """As many queued events as one message may carry."""
        num_bytes, num_events = 0, 0
        for event in self._send_queue:
            num_bytes += event.ByteSize() + 8
            if num_events and num_bytes > self._max_batch_bytes:
                break
            num_events += 1
        request = service_pb2.StreamMotionRequest(events=self._send_queue[:num_events], ping=self._ping)
        del self._send_queue[:num_events]
        self._ping = None
        return request

    def _take(self, response: service_pb2.StreamMotionResponse) -> None:
        match response.WhichOneof("stream_event"):
            case "hello":
                self.replica_id = response.hello.replica_id
                self._hello.set()
            case "pong":
                is_first = self.round_trip_s is None
                self.round_trip_s = asyncio.get_running_loop().time() - response.pong.client_time_ns / 1e9
                if is_first:
                    self._send_ping()  # which tells it to the server
            case "goodbye":
                self.draining = True
        for update in response.updates:
            session = self._sessions.get(update.session)
            if session is None:
                continue  # what was under way when the session ended here
            session._handle(update)
            if session._failure is not None:
                del self._sessions[update.session]

    # ---- timers

    async def _report_playheads(self) -> None:
        while True:
            try:
                async with asyncio.timeout(self._report_period_s):
                    await self._report_wanted.wait()
            except TimeoutError:
                pass  # the regular report
            self._report_wanted.clear()
            for session in self._sessions.values():
                if session.is_playing:
                    self.send(session._playhead())
            await asyncio.sleep(_MIN_REPORT_GAP_S)

    async def _send_pings(self) -> None:
        while True:
            self._send_ping()
            await asyncio.sleep(_PING_PERIOD_S)

    def _send_ping(self) -> None:
        now_ns = int(asyncio.get_running_loop().time() * 1e9)
        self._ping = convert.ping(now_ns, self.round_trip_s)
        self._something_to_send.set()
