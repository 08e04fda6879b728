"""Talk: a bare client for tests. It sends what a test tells it to, and checks every rule on what it receives."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import grpc.aio

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.heard import Heard, require
from motiongen_compliance.messages import addressed, close

LIMIT_S = 60.0
"""How long to wait for a message before the test fails. This is a bound, not a measurement."""
STREAM_LIMIT_S = 300.0
"""How long a stream may last: a server may send much without ever sending what a test waits for."""
REPORT_PERIOD_S = 0.2
"""Seconds between repeated reports of the same playhead: credit is earned in real time, and a report collects it."""


def rig_of(catalog: service_pb2.GetCatalogResponse) -> motion_pb2.Rig:
    """The rig of the first model, which sessions use unless they name another."""
    return next(rig for rig in catalog.rigs if rig.rig_id == catalog.models[0].rig_id)


class StreamOver(Exception):
    """The stream ended with OK while the test was waiting for more."""


class Talk:
    """One stream. Its sessions are identified by handle; opening a handle again starts afresh."""

    def __init__(self, stub: service_pb2_grpc.MotionServiceStub, catalog: service_pb2.GetCatalogResponse) -> None:
        self.catalog = catalog
        self.call = stub.StreamMotion()
        self.sessions: dict[int, Heard] = {}
        self.responses: list[service_pb2.StreamMotionResponse] = []
        self.ends_at = time.monotonic() + STREAM_LIMIT_S
        self._reading: asyncio.Task[object] | None = None
        self._goodbyes: set[int] = set()
        self._said_seq: dict[int, int] = {}  # the greatest number sent, by handle
        rig = rig_of(catalog)
        self._row_bytes, self._num_joints = 4 * sum(block.width for block in rig.blocks), len(rig.joints)

    # ---- sending ----------------------------------------------------------------------------------------------------

    async def hello(self) -> Talk:
        """Say hello and wait for the server's hello. Asks for a short flush interval."""
        hello = service_pb2.ClientHello(client_agent="compliance")
        hello.flush_interval.FromMilliseconds(5)
        await self.say(service_pb2.StreamMotionRequest(hello=hello))
        first = await self.hear()
        require(first.HasField("hello"), "the server's first message has hello")
        return self

    def note(self, request: service_pb2.StreamMotionRequest) -> None:
        """Record the events of a message, so that answers to them are expected. `say` calls this."""
        for event in request.events:
            self._said_seq[event.session] = max(event.event_seq, self._said_seq.get(event.session, 0))

    async def say(self, request: service_pb2.StreamMotionRequest) -> None:
        self.note(request)
        async with asyncio.timeout(LIMIT_S):
            await self.call.write(request)

    async def send(self, *events: session_pb2.SessionEvent) -> None:
        """Send events unchanged."""
        await self.say(service_pb2.StreamMotionRequest(events=events))

    async def ask_open(self, handle: int, **fields: object) -> Heard:
        """Send an OpenSession on an unused handle."""
        heard = self.sessions[handle] = self._nothing_heard()
        opening = session_pb2.OpenSession(**fields)  # type: ignore[arg-type]
        await self.send(session_pb2.SessionEvent(session=handle, event_seq=1, open=opening))
        return heard

    async def open(self, handle: int, **fields: object) -> Heard:
        """Open a session and wait for its first frames. If the server has no room, ask again after `retry_after`."""
        ends_at = time.monotonic() + LIMIT_S
        while True:
            heard = await self.ask_open(handle, **fields)
            while not heard.chunks and not heard.outcomes:
                await self.hear()
            if heard.opened is not None:
                return heard
            (refusal,) = heard.outcomes
            require(refusal.HasField("retry_after"), f"the session opens: {refusal}")
            if time.monotonic() > ends_at:
                raise TimeoutError(f"the server has had no room for a session for {LIMIT_S:g} s: {refusal}")
            await asyncio.sleep(max(0.1, refusal.retry_after.ToMilliseconds() / 1000))

    async def ask_resume(self, handle: int, heard: Heard, **fields: object) -> None:
        """Send an OpenSession that resumes a session of another stream."""
        assert heard.opened is not None
        heard.attempt += 1
        heard.is_resuming = True
        self.sessions[handle] = heard
        point = session_pb2.ResumePoint(
            next_frame=heard.next_frame,
            plan=heard.plans[-1].plan if heard.plans else 0,
            answered_seq=heard.applied_seq,
            attempt=heard.attempt,
        )
        asked: dict[str, object] = {"resume_token": heard.opened.session_token, "resume_point": point} | fields
        opening = session_pb2.OpenSession(**asked)  # type: ignore[arg-type]
        await self.send(session_pb2.SessionEvent(session=handle, event_seq=1, open=opening))

    async def resume(self, handle: int, heard: Heard) -> None:
        """Resume a session, and wait for the server to confirm it."""
        await self.ask_resume(handle, heard)
        await self.until(lambda: not heard.is_resuming or heard.outcome(1))
        require(not heard.is_resuming, f"the session is resumed: {heard.outcomes}")

    async def edit(self, handle: int, event: session_pb2.SessionEvent) -> session_pb2.EditOutcome:
        """Send the next event of a session and wait for its answer."""
        heard, options = self.sessions[handle], event.set_options
        heard.sent_seq += 1
        lookahead = options.lookahead_frames or self.catalog.limits.default_lookahead_frames
        before = heard.lookahead
        if options.HasField("lookahead_frames"):
            heard.lookahead = max(before, lookahead)  # either may apply to the frames that come meanwhile
        await self.send(addressed(event, handle, heard.sent_seq))
        outcome = await self.answer(handle, heard.sent_seq)
        if options.HasField("lookahead_frames"):
            heard.lookahead = lookahead if outcome.code == 0 else before
        return outcome

    async def answer(self, handle: int, event_seq: int) -> session_pb2.EditOutcome:
        heard = self.sessions[handle]
        await self.until(lambda: heard.outcome(event_seq) is not None)
        outcome = heard.outcome(event_seq)
        assert outcome is not None
        return outcome

    async def report(self, handle: int, frame: int) -> None:
        """Report the playhead, which extends the credit."""
        heard = self.sessions[handle]
        heard.playhead = max(heard.playhead, frame)
        playhead = session_pb2.Playhead(frame=frame, buffered_to=heard.next_frame)
        await self.send(session_pb2.SessionEvent(session=handle, playhead=playhead))

    async def close(self, handle: int) -> session_pb2.SessionClosed:
        heard = self.sessions[handle]
        heard.sent_seq += 1
        await self.send(addressed(close(), handle, heard.sent_seq))
        await self.until(lambda: heard.closed is not None)
        assert heard.closed is not None
        return heard.closed

    async def ping(self, number: int) -> service_pb2.Pong:
        """Send a ping and wait for its answer."""
        await self.say(service_pb2.StreamMotionRequest(ping=service_pb2.Ping(client_time_ns=number)))
        while True:
            response = await self.hear()
            if response.HasField("pong"):
                return response.pong

    async def finish(self) -> None:
        """End the stream properly, so that the server closes its sessions instead of keeping them to be resumed."""
        if self.call.done():
            return
        try:
            async with asyncio.timeout(LIMIT_S):
                await self.call.done_writing()
                reading = self._reading or asyncio.ensure_future(self.call.read())
                while await reading is not grpc.aio.EOF:
                    reading = asyncio.ensure_future(self.call.read())
        except (TimeoutError, grpc.aio.AioRpcError, grpc.aio.UsageError, asyncio.InvalidStateError):
            self.call.cancel()  # the test has already judged how the stream ended

    # ---- receiving --------------------------------------------------------------------------------------------------

    async def hear(self) -> service_pb2.StreamMotionResponse:
        """The next message. Raises StreamOver when the stream ends with OK, and AioRpcError when it ends otherwise."""
        if time.monotonic() > self.ends_at:
            raise TimeoutError(f"within {STREAM_LIMIT_S:g} s, the stream did not bring what the test waits for")
        if not await self._has_come(LIMIT_S):
            raise TimeoutError(f"nothing came for {LIMIT_S:g} s")
        assert self._reading is not None
        reading, self._reading = self._reading, None
        response = reading.result()
        if not isinstance(response, service_pb2.StreamMotionResponse):
            raise StreamOver
        require(response.HasField("hello") != bool(self.responses), "hello is in the first message, and only there")
        if response.HasField("goodbye"):
            require(response.goodbye.reason not in self._goodbyes, "a Goodbye comes once for each reason")
            self._goodbyes.add(response.goodbye.reason)
        self.responses.append(response)
        for update in response.updates:
            said_seq = self._said_seq.get(update.session)
            require(said_seq is not None, "no update is for a handle that the client never used")
            heard = self.sessions.setdefault(update.session, self._nothing_heard())
            heard.said_seq = max(heard.said_seq, said_seq or 0)
            heard.take(update)
        return response

    def _nothing_heard(self) -> Heard:
        return Heard(self._row_bytes, self._num_joints)

    async def _has_come(self, limit_s: float) -> bool:
        """Whether the next message, or the end, arrives within `limit_s`. A read is never cancelled."""
        if self._reading is None:
            self._reading = asyncio.ensure_future(self.call.read())
        await asyncio.wait({self._reading}, timeout=limit_s)
        return self._reading.done()

    async def until(self, holds: Callable[[], object]) -> None:
        """Receive messages until `holds` returns something true."""
        while not holds():
            await self.hear()

    async def to_the_end(self) -> grpc.StatusCode:
        """Receive all that is left; returns the status, OK or not."""
        try:
            while True:
                await self.hear()
        except StreamOver:
            return await self.call.code()
        except grpc.aio.AioRpcError as error:
            return error.code()

    async def plays_on(self, handle: int) -> None:
        """Play what a session has sent, and wait for more: a playhead that jumps earns its credit in real time."""
        heard = self.sessions[handle]
        before = heard.end
        await self.report(handle, before - 1)
        async with asyncio.timeout(LIMIT_S):
            while heard.end == before and heard.closed is None:
                if await self._has_come(REPORT_PERIOD_S):
                    await self.hear()
                else:
                    await self.report(handle, before - 1)
        require(heard.closed is None, f"the session stays open: {heard.closed}")
