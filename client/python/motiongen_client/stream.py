"""Stream: carries sessions over a call to the server, and makes another call when one is lost."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_client import convert
from motiongen_client.backlog import Backlog, SendQueue
from motiongen_client.call_events import CallEvents
from motiongen_client.calls import Calls
from motiongen_client.catalogs import has_model, newest_catalog
from motiongen_client.channel import Route
from motiongen_client.errors import EventRefused, InvalidInput, MotiongenError, ServerUnavailable, StreamLost
from motiongen_client.line_policy import LinePolicy
from motiongen_client.prompts import Prompt
from motiongen_client.reports import Reports
from motiongen_client.session import Session
from motiongen_client.types import NO_PROMPTS, Catalog, Constraint, SessionOptions, check_number, check_type


class Stream:
    """Sessions that share a call to the server. Made by `MotionClient.stream`; use it as `async with`.

    report_hz: how often playheads are reported; the server paces sessions and grants credit by them. draining: whether
    the server has sent a Goodbye. replica_id: the server's name.
    """

    def __init__(
        self,
        connect: Callable[[], grpc.aio.Channel],
        address: str,
        catalog: Catalog,
        agent: str,
        *,
        report_hz: float = 2.0,
        policy: LinePolicy | None = None,
        move: Callable[[Stream, Session, EventRefused], bool] | None = None,
        route: Route | None = None,
        on_catalog: Callable[[Catalog], None] | None = None,
    ) -> None:
        """connect: makes a channel to the server, for one call.

        move: moves a session for which there is no capacity here to another stream; returns False if none is known.
        route: decides where the channels made by `connect` lead; None: always to the same server. on_catalog: called
        with each catalogue fetched from the route's own address.
        """
        check_number("report_hz", report_hz, "a number from 1 to 5", lambda each: 1 <= each <= 5)
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
        """The sessions on this stream."""
        return tuple(self._sessions.values())

    @property
    def is_connected(self) -> bool:
        """Whether there is a call at present."""
        return self._calls.is_connected

    @property
    def is_over(self) -> bool:
        """Whether it was closed or has failed for good."""
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
        """Create a character, directed by a prompt and constraints from its first frame on.

        later_prompts: keyed by the frame at which each takes over, as `set_prompt` with a frame schedules them.
        keep_s: how many seconds of motion behind the playhead stay readable; None keeps all.
        While the connection is lost, it waits for the next. Raises EventRefused if the server refuses the session, and
        StreamLost if the stream is lost for good.
        """
        options = SessionOptions() if options is None else options
        check_type("options", options, SessionOptions, "SessionOptions, or None")
        is_stale = False
        while True:
            await self._calls.until_connected()
            call = self._calls.number
            try:
                if is_stale or not has_model(self._catalog, options):
                    await self._fetch_catalog(self._calls.channel)
                return await self._open(options, prompt, later_prompts, constraints, keep_s)
            except EventRefused as refusal:
                if refusal.reason == "DRAINING" and self.recovers:  # a server is available again soon
                    await self._calls.until_after(call)
                elif options.model_id or refusal.reason != "UNKNOWN_MODEL" or is_stale:
                    raise
                else:
                    is_stale = True  # the default model has been unloaded since
            except (ServerUnavailable, StreamLost):  # of the request for the catalogue
                if not await self._calls.is_lost(call):
                    raise

    async def _open(
        self,
        options: SessionOptions,
        prompt: Prompt | None,
        later_prompts: Mapping[int, Prompt],
        constraints: Sequence[Constraint],
        keep_s: float | None,
    ) -> Session:
        if not options.model_id and self._catalog.models:  # of the catalogue in which its rig is looked up
            options = replace(options, model_id=self._catalog.models[0].model_id)
        session = Session(self._next_handle, self, self._catalog, asyncio.get_running_loop().time)
        self._next_handle += 1
        self._sessions[session.handle] = session
        try:
            await session.begin(options, prompt, later_prompts, constraints, keep_s)
        except asyncio.CancelledError:  # the server has been asked; no caller is left to close the session
            session.abandon()
            self._sweep()
            raise
        except BaseException:
            self._sessions.pop(session.handle, None)
            raise
        return session

    async def _fetch_catalog(self, channel: grpc.aio.Channel | None) -> None:
        """Fetch the catalogue again: models may have been loaded or unloaded, or this is another server."""
        if channel is None:
            return
        stub, timeout_s = MotionServiceStub(channel), self._policy.hello_timeout_s
        self._catalog = await newest_catalog(stub, self._catalog, self._address, timeout_s)
        if self._on_catalog is not None and (self._route is None or self._route.is_at_home):
            self._on_catalog(self._catalog)

    async def start(self) -> Stream:
        """Make the call and exchange hellos. `async with` calls it. Raises ServerUnavailable or StreamLost."""
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
        """Wait until there is a call, making one if needed: servers end the calls of streams without sessions.

        Raises ServerUnavailable if there is none within the policy's hello_timeout_s, and StreamLost if the stream is
        over.
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
        """The number of the present call; it rises with each reconnection."""
        return self._calls.number

    def check(self, event: session_pb2.SessionEvent) -> None:
        """Raise InvalidInput if an event is too big for a message."""
        most = self._most_event_bytes()
        if event.ByteSize() > most:
            allowed = f"at most {most} bytes in one event; split it"
            raise InvalidInput(event.WhichOneof("event") or "event", f"{event.ByteSize()} bytes", allowed)

    def _most_event_bytes(self) -> int:
        return self._catalog.limits.max_request_bytes * 9 // 10  # the rest is for the message around the events

    def send(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event for the next message. It is dropped while the connection is lost."""
        self._calls.send(event)

    def report_soon(self) -> None:
        """Report playheads without waiting for the next regular report."""
        self._reports.soon()

    def move_elsewhere(self, handle: int, refusal: EventRefused) -> bool:
        """See `Carrier`."""
        session = self._sessions.get(handle)
        return self._move is not None and session is not None and self._move(self, session, refusal)

    # ---- sessions that move between streams

    def release(self, session: Session) -> None:
        """Stop carrying a session."""
        self._sessions.pop(session.handle, None)

    def adopt(self, session: Session) -> None:
        """Carry a session that waits for a server; this one is asked as soon as there is a call."""
        handle = self._next_handle
        self._next_handle += 1
        self._sessions[handle] = session
        session.move(handle, self, self._catalog, now=self.is_connected)
        if not self.is_connected:
            self._calls.ask()

    async def ask_catalog(self) -> None:
        """Replace the held catalogue with this server's own. Raises ServerUnavailable."""
        await self._fetch_catalog(self._calls.channel)

    # ---- events of the calls

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
        """Remove the sessions that were closed while the connection was lost."""
        self._sessions = {handle: session for handle, session in self._sessions.items() if not session.is_over}

    def _fail(self, failure: MotiongenError) -> None:
        for session in self.sessions:
            session.fail(failure)
        self._sessions.clear()
        self._reports.cancel()

    def _take(self, response: service_pb2.StreamMotionResponse) -> None:
        match response.WhichOneof("stream_event"):
            case "hello":
                self.replica_id = convert.text(response.hello.replica_id)
            case "goodbye":
                self.draining = True
                self._calls.reconnect_after_s = convert.seconds(response.goodbye.reconnect_after)
                self._calls.other_servers = convert.other_servers(response.goodbye.other_servers)
        for update in response.updates:
            session = self._sessions.get(update.session)
            if session is None:
                continue  # it was in flight when the session ended here
            session.hear(update)
            if session.is_over:
                del self._sessions[update.session]

    def _report_playheads(self) -> None:
        for session in self.sessions:
            if session.is_reporting and not self.backlog.is_queue_full:  # the next report supersedes it
                self.send(session.report())
