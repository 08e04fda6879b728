"""One stream: its sessions by handle, the order of their events, and what it still has to send."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import service_pb2, session_pb2
from server.catalog import Catalog
from server.convert import engine_event, prompt_texts, session_update
from server.engine.types import (
    Close,
    Closed,
    CloseReason,
    Code,
    Opened,
    Outcome,
    Output,
    SessionKey,
)
from server.engine_port import EventSink
from server.errors import EventRefused
from server.outbox import Outbox
from server.prompts import PromptEncoder
from server.rate import TokenBucket

_log = logging.getLogger(__name__)

MAX_RESPONSE_BYTES = 3 << 20
MAX_WAITING_REPLIES = 64


@dataclass(slots=True)
class Link:
    """One session as its stream knows it.

    last_seq: the highest event number taken. answered: numbers above applied_seq that have been answered already.
    waiting: events held back behind one whose prompt is being encoded. known_to_engine: whether its open was passed on.
    closing: whether its close was.
    """

    key: SessionKey
    request_id: str
    bucket: TokenBucket
    last_seq: int = 1
    applied_seq: int = 0
    answered: set[int] = field(default_factory=set)
    waiting: deque[tuple[session_pb2.SessionEvent, float]] = field(default_factory=deque)
    encoding: asyncio.Task[None] | None = None
    known_to_engine: bool = False
    closing: bool = False

    def answer(self, event_seq: int) -> None:
        """Note that an event has been answered, and move applied_seq over all that are."""
        if event_seq > self.applied_seq:
            self.answered.add(event_seq)
        while self.applied_seq + 1 in self.answered:
            self.applied_seq += 1
            self.answered.discard(self.applied_seq)


def refusal_outcome(session: SessionKey, event_seq: int, refusal: EventRefused) -> Outcome:
    """The answer to an event that was refused."""
    return Outcome(
        session,
        event_seq,
        refusal.code,
        reason=refusal.reason,
        message=str(refusal),
        field=refusal.field,
        allowed=refusal.allowed,
    )


def closed_before() -> EventRefused:
    """Why an event that found its session closing was refused."""
    return EventRefused(
        Code.CANCELLED,
        "SESSION_CLOSED",
        "the session closed before the event took effect",
        field="session",
        allowed="open a new session after SessionClosed",
    )


class Stream:
    """The state of one StreamMotion call. Everything here runs on the event loop."""

    def __init__(self, number: int, engine: EventSink, prompts: PromptEncoder, catalog: Catalog) -> None:
        self.number = number
        self.outbox = Outbox()
        self.ready = asyncio.Event()  # something to write, or the end
        self.urgent = asyncio.Event()  # something that must not wait for the flush interval
        self.flush_s = 0.0
        self.accepts_opens = True
        self.greeted = False  # both sides have said hello
        self.ended = False
        self.responses: deque[service_pb2.StreamMotionResponse] = deque()
        self._engine = engine
        self._prompts = prompts
        self._catalog = catalog
        self._links: dict[int, Link] = {}
        self._bucket = TokenBucket(catalog.limits.stream_events_per_second, time.monotonic())
        self._backlog_since: float | None = None
        self._room = asyncio.Event()

    @property
    def num_sessions(self) -> int:
        return len(self._links)

    # ---- from the client --------------------------------------------------------------------------------------------

    def receive(self, event: session_pb2.SessionEvent) -> None:
        """Take one event of the client: hand it to the engine, or answer why not."""
        now = time.monotonic()
        try:
            link = self._admit(event, now)
        except EventRefused as refusal:
            # It never became an event of the session, so the session's books must not know its number.
            outcome = refusal_outcome(SessionKey(self.number, event.session), event.event_seq, refusal)
            self._say(outcome, self._links.get(event.session))
            return
        if link is None:
            return
        try:
            if event.WhichOneof("event") != "close":  # which asks for less work, not for more
                self._take_tokens(link, now)
            self._pass_on(link, event, now)
        except EventRefused as refusal:
            self.take(refusal_outcome(link.key, event.event_seq, refusal))
        except Exception as error:
            self._internal_error(link, event.event_seq, error)

    def _admit(self, event: session_pb2.SessionEvent, now: float) -> Link | None:
        """The session that the event is the next one of; None where it is to be dropped. Raises EventRefused."""
        kind = event.WhichOneof("event")
        if kind == "open":
            return self._open(event, now)
        link = self._links.get(event.session)
        if link is None:
            if kind == "playhead":
                return None  # a report that crossed the session's end
            raise EventRefused(
                Code.NOT_FOUND,
                "SESSION_NOT_OPEN",
                f"no session is open on handle {event.session}",
                field="session",
                allowed="the handle of an open session; send OpenSession first",
            )
        return link if self._in_order(link, event) else None

    def _open(self, event: session_pb2.SessionEvent, now: float) -> Link | None:
        handle, limits = event.session, self._catalog.limits
        link = self._links.get(handle)
        if link is not None:
            if event.open.request_id and event.open.request_id == link.request_id:
                return None  # the same open again
            raise EventRefused(
                Code.ALREADY_EXISTS,
                "HANDLE_IN_USE",
                f"handle {handle} carries an open session",
                field="session",
                allowed="a handle that is not in use, or this one after its SessionClosed",
            )
        if not self.accepts_opens:
            raise EventRefused(
                Code.UNAVAILABLE,
                "DRAINING",
                "the server is shutting down and opens no more sessions",
                field="open",
                allowed="open on another server, or here after a restart",
            )
        if event.event_seq != 1:
            raise self._gap(event.event_seq, 1)
        if len(self._links) >= limits.max_sessions_per_stream:
            raise EventRefused(
                Code.RESOURCE_EXHAUSTED,
                "TOO_MANY_SESSIONS",
                f"the stream carries {len(self._links)} sessions",
                field="open",
                allowed=f"at most {limits.max_sessions_per_stream} on a stream; use another stream",
            )
        key = SessionKey(self.number, handle)
        link = Link(key, event.open.request_id, TokenBucket(limits.events_per_second, now))
        self._links[handle] = link
        return link

    def _in_order(self, link: Link, event: session_pb2.SessionEvent) -> bool:
        """Whether the event is new and next; false for a repetition. Raises EventRefused for a gap."""
        is_report = event.WhichOneof("event") == "playhead"
        if is_report != (event.event_seq == 0):
            raise EventRefused(
                Code.INVALID_ARGUMENT,
                "INVALID_EVENT_SEQ",
                f"event_seq is {event.event_seq}",
                field="event_seq",
                allowed="0 for Playhead, else one more than the session's last event",
            )
        if is_report:
            return True
        if event.event_seq <= link.last_seq:
            return False
        if event.event_seq != link.last_seq + 1:
            raise self._gap(event.event_seq, link.last_seq + 1)
        link.last_seq = event.event_seq
        return True

    @staticmethod
    def _gap(given: int, expected: int) -> EventRefused:
        return EventRefused(
            Code.FAILED_PRECONDITION,
            "SEQUENCE_GAP",
            f"event_seq is {given}, the next is {expected}",
            field="event_seq",
            allowed=str(expected),
        )

    def _take_tokens(self, link: Link, now: float) -> None:
        limits = self._catalog.limits
        buckets = (
            ("stream", self._bucket, limits.stream_events_per_second),
            ("session", link.bucket, limits.events_per_second),
        )
        for what, bucket, rate in buckets:
            if not bucket.take(now):
                raise EventRefused(
                    Code.RESOURCE_EXHAUSTED,
                    "TOO_MANY_EVENTS",
                    f"the {what} sends events too fast",
                    field="event",
                    allowed=f"{rate:g} a second",
                )

    def _pass_on(self, link: Link, event: session_pb2.SessionEvent, now: float) -> None:
        """Submit at once if nothing of the session waits and its prompts are known, else queue behind the encoder."""
        if event.WhichOneof("event") == "playhead":
            if link.known_to_engine and not link.closing:
                self._submit(link, event, now, {})  # a report overtakes: it is about now
            return
        if not link.waiting and link.encoding is None:
            known = self._known_embeddings(event)
            if known is not None:
                self._submit(link, event, now, known)
                return
        link.waiting.append((event, now))
        if link.encoding is None:
            link.encoding = asyncio.get_running_loop().create_task(self._encode_waiting(link))

    def _known_embeddings(self, event: session_pb2.SessionEvent) -> dict[str, NDArray[np.float32]] | None:
        known = {}
        for text in prompt_texts(event, self._catalog):
            embedding = self._prompts.cached(text)
            if embedding is None:
                return None
            known[text] = embedding
        return known

    async def _encode_waiting(self, link: Link) -> None:
        try:
            while link.waiting:
                event, received_at = link.waiting[0]  # it stays while it is encoded, so that `_refuse_waiting` finds it
                embeddings: dict[str, NDArray[np.float32]] = {}
                failure: Exception | None = None
                try:
                    for text in () if link.closing else prompt_texts(event, self._catalog):
                        embeddings[text] = await self._prompts.encode(text)
                except Exception as error:
                    failure = error
                link.waiting.popleft()
                try:
                    if failure is not None:
                        raise failure
                    self._submit(link, event, received_at, embeddings)
                except EventRefused as refusal:
                    self.take(refusal_outcome(link.key, event.event_seq, refusal))
                except Exception as error:
                    self._internal_error(link, event.event_seq, error)
        finally:
            link.encoding = None
            self.ready.set()

    def _refuse_waiting(self, link: Link) -> None:
        """Answer what waits for the encoder: its session is over."""
        if link.encoding is not None and link.encoding is not asyncio.current_task():
            link.encoding.cancel()
        waiting, link.waiting = link.waiting, deque()
        for event, _ in waiting:
            self.take(refusal_outcome(link.key, event.event_seq, closed_before()))

    def _submit(
        self, link: Link, message: session_pb2.SessionEvent, now: float, embeddings: dict[str, NDArray[np.float32]]
    ) -> None:
        if link.closing:
            raise closed_before()
        event = engine_event(message, link.key, now, embeddings, self._catalog)
        link.closing = isinstance(event, Close)
        link.known_to_engine = True
        refusal = self._engine.submit(event)
        if refusal is not None:
            self.take(refusal)

    def _internal_error(self, link: Link, event_seq: int, error: Exception) -> None:
        error_id = secrets.token_hex(4)
        _log.error("event failed, error id %s", error_id, exc_info=error)
        refusal = EventRefused(Code.INTERNAL, "INTERNAL", f"the event failed inside the server, error id {error_id}")
        self.take(refusal_outcome(link.key, event_seq, refusal))

    # ---- from the engine --------------------------------------------------------------------------------------------

    def take(self, output: Output) -> None:
        """Take one output for this stream's client, and keep the session's books."""
        link = self._links.get(output.session.handle)
        if link is not None:
            if isinstance(output, Opened):
                link.answer(1)
            elif isinstance(output, Outcome) and output.event_seq:
                link.answer(output.event_seq)
                if output.event_seq == 1:  # an OpenSession has an outcome only when it is refused: the handle is unused
                    self._refuse_waiting(link)
                    del self._links[output.session.handle]
            elif isinstance(output, Closed):
                self._refuse_waiting(link)  # before the end is told and the handle can be used again
                link.applied_seq = link.last_seq
                del self._links[output.session.handle]
        self._say(output, link)

    def _say(self, output: Output, link: Link | None) -> None:
        # The number as of now: by the time it is written, later events may have been answered in later updates.
        self.outbox.put(output, link.applied_seq if link is not None else 0)
        self.check_backlog()
        self.ready.set()

    def next_response(self) -> service_pb2.StreamMotionResponse | None:
        """The next message to write: pongs and goodbyes first, then updates of many sessions in one."""
        self._room.set()
        if self.responses:
            return self.responses.popleft()
        outputs = self.outbox.take(MAX_RESPONSE_BYTES)
        if not outputs:
            return None
        response = service_pb2.StreamMotionResponse()
        for output, applied_seq in outputs:
            update = session_update(output, self._catalog)
            update.applied_seq = applied_seq
            response.updates.append(update)
        return response

    def reply(self, response: service_pb2.StreamMotionResponse) -> None:
        """Send a message that belongs to no session ahead of the updates."""
        self.responses.append(response)
        self.urgent.set()
        self.ready.set()

    async def room(self) -> None:
        """Let other streams have a turn, and wait until there is room for more answers, or the stream ends.

        Events that are refused cost the client a few bytes and the server an answer each; one that sends them and does
        not read would fill the memory. Not reading on passes the wait to the client, by gRPC's own flow control.
        """
        await asyncio.sleep(0)
        while not self.ended and (
            self.outbox.num_bytes > self._catalog.limits.hard_backlog_bytes or len(self.responses) > MAX_WAITING_REPLIES
        ):
            self._room.clear()
            await self._room.wait()

    # ---- ends -------------------------------------------------------------------------------------------------------

    def check_backlog(self) -> None:
        """Close every session when the client reads too slowly: too much unsent at once, or a lot for too long."""
        limits, now = self._catalog.limits, time.monotonic()
        if self.outbox.num_bytes <= limits.soft_backlog_bytes:
            self._backlog_since = None
            return
        self._backlog_since = self._backlog_since or now
        if self.outbox.num_bytes > limits.hard_backlog_bytes or now - self._backlog_since > limits.backlog_s:
            self.close_all(CloseReason.SLOW_READER)

    def close_all(self, reason: CloseReason) -> None:
        """Ask the engine to close every session of the stream that is not closing already."""
        now = time.monotonic()
        for link in list(self._links.values()):
            self._refuse_waiting(link)  # the first may be the OpenSession itself, which is then refused
            if link.known_to_engine and not link.closing:
                link.closing = True
                self._engine.submit(Close(link.key, link.last_seq + 1, now, reason))

    def abandon(self) -> None:
        """The client is gone: close everything and write nothing more."""
        self.close_all(CloseReason.CLIENT)
        self.end()

    def end(self) -> None:
        """Let the write loop finish what is there and stop."""
        self.ended = True
        self._room.set()
        self.urgent.set()
        self.ready.set()
