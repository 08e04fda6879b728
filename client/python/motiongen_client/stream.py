"""A stream of sessions, over one call to the server after another: when one is lost, the next takes its place."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_client import convert
from motiongen_client.backlog import Backlog, SendQueue
from motiongen_client.calls import CallEvents, Calls
from motiongen_client.catalogs import has_model, newest_catalog
from motiongen_client.channel import Route
from motiongen_client.errors import EventRefused, InvalidInput, MotiongenError, ServerUnavailable
from motiongen_client.line_policy import LinePolicy
from motiongen_client.prompts import Prompt
from motiongen_client.reports import Reports
from motiongen_client.session import Session
from motiongen_client.types import NO_PROMPTS, Catalog, Constraint, SessionOptions


class Stream:
    """Sessions that share a call to the server. Made by `MotionClient.stream`; use it as `async with`.

    report_hz: how often the server hears the playheads, which are its clock and its credit. draining: whether the
    server has said goodbye. replica_id: its name.
    """

    def __init__(
        self,
        connect: Callable[[], grpc.aio.Channel],
        address: str,
        catalog: Catalog,
        agent: str,
        *,
        report_hz: float = 4.0,
        policy: LinePolicy | None = None,
        move: Callable[[Stream, Session, EventRefused], bool] | None = None,
        route: Route | None = None,
        on_catalog: Callable[[Catalog], None] | None = None,
    ) -> None:
        """connect: makes a channel to the server, for one call.

        move: has another stream carry a session for which there is no room here; False where none is known. route: of
        the channels that `connect` makes; None: they all lead to one server. on_catalog: is told of each catalogue that
        is fetched from the route's own address.
        """
        if not 1 <= report_hz <= 5:
            raise InvalidInput("report_hz", report_hz, "a number from 1 to 5")
        self._address = address
        self._catalog = catalog
        self._reports = Reports(1 / report_hz, self._report_playheads)
        self._policy = policy or LinePolicy()
        events = CallEvents(self._take, self._hear_hello, self._begin, self._interrupt, self._fail)
        self.backlog = Backlog()
        self._calls = Calls(
            connect,
            address,
            agent,
            self._policy,
            make_queue=lambda: SendQueue(self.backlog, self._most_event_bytes),
            events=events,
            route=route,
        )
        self._move, self._route, self._on_catalog = move, route, on_catalog
        self._sessions: dict[int, Session] = {}
        self._next_handle = 1
        self.replica_id = ""
        self.draining = False

    @property
    def sessions(self) -> tuple[Session, ...]:
        """The sessions that live on this stream."""
        return tuple(self._sessions.values())

    @property
    def is_connected(self) -> bool:
        """Whether there is a call at present."""
        return self._calls.is_connected

    @property
    def is_over(self) -> bool:
        """Whether it was closed, or given up for good."""
        return self._calls.failure is not None

    @property
    def round_trip_s(self) -> float | None:
        """As last measured; None before the first measurement."""
        return self._calls.round_trip_s

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
        While the line is lost it waits for another. Raises EventRefused when the server refuses it, StreamLost when the
        stream is gone for good.
        """
        options = options or SessionOptions()
        while True:
            await self._calls.until_connected()
            call = self._calls.number
            if not has_model(self._catalog, options):
                await self._fetch_catalog(self._calls.channel)
            try:
                return await self._open(options, prompt, later_prompts, constraints, keep_s)
            except EventRefused as refusal:
                if refusal.reason == "DRAINING" and self.recovers:  # another server, or this one, is there soon
                    await self._calls.until_after(call)
                elif options.model_id or refusal.reason != "UNKNOWN_MODEL":
                    raise
                else:
                    await self._fetch_catalog(self._calls.channel)  # the default was unloaded since
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
            await session.begin(options, prompt, later_prompts, constraints, keep_s)
        except asyncio.CancelledError:  # the server has been asked, and nobody is left who could end the session
            session.abandon()
            self._sweep()
            raise
        except BaseException:
            self._sessions.pop(session.handle, None)
            raise
        return session

    async def _fetch_catalog(self, channel: grpc.aio.Channel | None) -> None:
        """The server may have loaded and unloaded models since the client connected, or be another one."""
        if channel is None:
            return
        stub, timeout_s = MotionServiceStub(channel), self._policy.hello_timeout_s
        self._catalog = await newest_catalog(stub, self._catalog, self._address, timeout_s)
        if self._on_catalog is not None and (self._route is None or self._route.is_at_home):
            self._on_catalog(self._catalog)

    async def start(self) -> Stream:
        """Make the call and exchange hellos. `async with` does it. Raises ServerUnavailable or StreamLost."""
        try:
            await self._calls.start()
        except BaseException:
            await self.close()
            raise
        self._reports.begin()
        return self

    async def close(self) -> None:
        """End all sessions and the call. May be called again."""
        await self._reports.close()
        await self._calls.close()

    async def ready(self) -> None:
        """Wait for a call, and ask for one where there is none: servers end streams that carry nothing.

        Raises ServerUnavailable where none comes within the policy's hello_timeout_s, StreamLost where none ever will.
        """
        within_s = self._policy.hello_timeout_s
        try:
            async with asyncio.timeout(within_s):
                await self._calls.until_connected()
        except TimeoutError:
            raise ServerUnavailable(self._address, f"no call was made within {within_s:g} s") from None

    async def __aenter__(self) -> Stream:
        return await self.start()

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    # ---- for the sessions

    @property
    def recovers(self) -> bool:
        """Whether a lost call is followed by another."""
        return self._calls.recovers

    @property
    def call_number(self) -> int:
        """Rises with each call that takes the place of a lost one."""
        return self._calls.number

    def check(self, event: session_pb2.SessionEvent) -> None:
        """Raise InvalidInput when an event is too big for a message."""
        most = self._most_event_bytes()
        if event.ByteSize() > most:
            allowed = f"at most {most} bytes in one event; split it"
            raise InvalidInput(event.WhichOneof("event") or "event", f"{event.ByteSize()} bytes", allowed)

    def _most_event_bytes(self) -> int:
        return self._catalog.limits.max_request_bytes * 9 // 10  # the rest is for the message around the events

    def send(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event; it goes out with the next message. While the line is lost it goes nowhere."""
        self._calls.send(event)

    def report_soon(self) -> None:
        """Report playheads without waiting for the next regular report."""
        self._reports.soon()

    def move_elsewhere(self, handle: int, refusal: EventRefused) -> bool:
        """As in Carrier."""
        session = self._sessions.get(handle)
        return self._move is not None and session is not None and self._move(self, session, refusal)

    # ---- sessions that go from one stream to another

    def release(self, session: Session) -> None:
        """Carry a session no more."""
        self._sessions.pop(session.handle, None)

    def adopt(self, session: Session) -> None:
        """Carry a session that waits for a server, which is asked as soon as there is a call."""
        handle = self._next_handle
        self._next_handle += 1
        self._sessions[handle] = session
        session.move(handle, self, self._catalog, now=self.is_connected)
        if not self.is_connected:
            self._calls.ask()

    async def ask_catalog(self) -> None:
        """Take the server's own catalogue in place of the one that is held. Raises ServerUnavailable."""
        await self._fetch_catalog(self._calls.channel)

    # ---- what becomes of the calls

    async def _hear_hello(self, channel: grpc.aio.Channel) -> None:
        if self._calls.number:
            await self._fetch_catalog(channel)

    def _begin(self) -> None:
        self.draining = False
        self._sweep()
        for session in self.sessions:
            session.reattach(self._catalog)

    def _interrupt(self) -> bool:
        for session in self.sessions:
            session.interrupt()
        self._sweep()
        return bool(self._sessions)

    def _sweep(self) -> None:
        """Forget the sessions that were closed while the line was lost."""
        self._sessions = {handle: session for handle, session in self._sessions.items() if not session.is_over}

    def _fail(self, failure: MotiongenError) -> None:
        for session in self.sessions:
            session.fail(failure)
        self._sessions.clear()
        self._reports.cancel()

    def _take(self, response: service_pb2.StreamMotionResponse) -> None:
        match response.WhichOneof("stream_event"):
            case "hello":
                self.replica_id = response.hello.replica_id
            case "goodbye":
                self.draining = True
                self._calls.reconnect_after_s = convert.seconds(response.goodbye.reconnect_after)
                self._calls.other_servers = convert.other_servers(response.goodbye.other_servers)
        for update in response.updates:
            session = self._sessions.get(update.session)
            if session is None:
                continue  # what was under way when the session ended here
            session.hear(update)
            if session.is_over:
                del self._sessions[update.session]

    def _report_playheads(self) -> None:
        for session in self.sessions:
            if session.is_reporting and not self.backlog.is_queue_full:  # the next says it all
                self.send(session.report())
