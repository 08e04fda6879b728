"""One stream: its sessions by handle, the order of their events, and what it still has to send."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.engine.types import (
    Chunk,
    Close,
    Closed,
    CloseReason,
    Code,
    Opened,
    Outcome,
    Output,
    PlanNotice,
    Priority,
    Resume,
    Resumed,
    SessionKey,
)
from motiongen_server.engine.types.refusals import draining, handle_in_use, session_not_open
from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.budget import REFUSAL_COST, StreamBudget
from motiongen_server.rpc.convert import check_resume, playhead_of
from motiongen_server.rpc.event_errors import (
    invalid_event_seq,
    resume_out_of_range,
    resume_superseded,
    sequence_gap,
    session_not_kept,
    too_fast,
    too_many_sessions,
)
from motiongen_server.rpc.event_path import pass_on, refuse_waiting, tell_internal_error
from motiongen_server.rpc.kept_sessions import KeptSessions
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.peers import Peer
from motiongen_server.rpc.reader_patience import ReaderPatience
from motiongen_server.rpc.response import response_of
from motiongen_server.rpc.send_queue import SendQueue
from motiongen_server.rpc.session_entry import TOKEN_BYTES, SessionEntry
from motiongen_server.rpc.stream_metrics import NoStreamMetrics, StreamMetrics
from motiongen_server.rpc.token_bucket import TokenBucket

MAX_RESPONSE_BYTES = 1 << 20
MAX_WAITING_REPLIES = 64


class Stream:
    """The state of one StreamMotion call. Everything here runs on the event loop."""

    def __init__(
        self,
        number: int,
        models: ModelRegistry,
        stream_metrics: StreamMetrics | None = None,
        kept: KeptSessions | None = None,
        peer: Peer | None = None,
    ) -> None:
        """kept: the sessions that can be resumed, of all streams; none where it is left out.

        peer: whom what comes is charged to besides the stream; one of its own where it is left out.
        """
        now = time.monotonic()
        self.number = number
        self.began_at = now
        self.peer = peer or Peer(PeerLimits(), now)
        self.budget = StreamBudget(models.limits.stream_events_per_second, self.peer, now)
        self.send_queue = SendQueue()
        self.ready = asyncio.Event()  # something to write, or the end
        self.urgent = asyncio.Event()  # something that must not wait for the flush interval
        self.flush_s = 0.0
        self.accepts_opens = True
        self.greeted = False  # both sides have said hello
        self.ended = False
        self.writing_since: float | None = None  # monotonic seconds, while a message is being written
        self.cut: Callable[[], object] = lambda: None  # breaks off what is being written
        self.empty_since = now  # monotonic seconds, while there is no session
        self.refusal: StreamRefused | None = None  # why the stream is ended, where its client is at fault
        self.rtt_s: float | None = None  # the client's last measurement
        self.responses: deque[service_pb2.StreamMotionResponse] = deque()
        self._models = models
        self._limits = models.limits
        self._stream_metrics = stream_metrics or NoStreamMetrics()
        self._dropped_told = 0
        self._kept = kept or KeptSessions(0)
        self._entries: dict[int, SessionEntry] = {}  # by the handle that they have here
        self._by_key: dict[SessionKey, SessionEntry] = {}
        self._patience = ReaderPatience(self._limits, self._give_up_on_reader)
        self._room = asyncio.Event()
        self._probe: asyncio.Future[None] | None = None

    @property
    def num_sessions(self) -> int:
        return len(self._entries)

    @property
    def num_waiting_bytes(self) -> int:
        """What waits to be written, about."""
        return self.send_queue.num_bytes

    # ---- from the client --------------------------------------------------------------------------------------------

    def receive(self, event: session_pb2.SessionEvent, now: float) -> None:
        """Take one event of the client, read at `now` and charged: hand it to the engine, or answer why not."""
        kind = event.WhichOneof("event")
        entry = self._entries.get(event.session)
        try:
            if kind == "playhead":
                self._report(event, entry, now)
                return
            entry = self._open(event, entry, now) if kind == "open" else self._next_of(event, entry)
        except EventRefused as refusal:
            # It never became an event of the session, so the session's books must not know its number.
            key = SessionKey(self.number, event.session)
            if kind == "open" and refusal.code is Code.RESOURCE_EXHAUSTED:
                self._stream_metrics.reject(refusal.reason)
            self.budget.charge(REFUSAL_COST, now)
            self._say(refusal.outcome(key, event.event_seq), entry)
            return
        if entry is None:
            return
        try:
            if kind != "close":  # which asks for less work, not for more
                self._take_token(entry, now)
            pass_on(entry, event, now)
        except EventRefused as refusal:
            self.budget.charge(REFUSAL_COST, now)
            self.take(refusal.outcome(entry.key, event.event_seq))
        except Exception as error:
            tell_internal_error(entry, event.event_seq, error)

    def _report(self, event: session_pb2.SessionEvent, entry: SessionEntry | None, now: float) -> None:
        """Pass a playhead on, past whatever waits: it is about now. Raises EventRefused."""
        if entry is None:
            return  # it crossed the session's end
        if event.event_seq:
            raise invalid_event_seq(event.event_seq)
        self._take_token(entry, now)
        entry.confirm(event.playhead.answered_seq)
        entry.note_shown(event.playhead.frame)
        if entry.known_to_engine and not entry.closing:
            entry.model.engine.submit(playhead_of(event.playhead, entry.key, now, self.rtt_s))

    def _next_of(self, event: session_pb2.SessionEvent, entry: SessionEntry | None) -> SessionEntry | None:
        """The session that the event is the next one of; None where it is to be dropped. Raises EventRefused."""
        if entry is None:
            raise session_not_open(event.session)
        return entry if entry.takes(event.event_seq) else None

    def _open(self, event: session_pb2.SessionEvent, entry: SessionEntry | None, now: float) -> SessionEntry | None:
        handle, limits = event.session, self._limits
        if entry is not None:
            if event.open.request_id and event.open.request_id == entry.request_id:
                return None  # the same open again
            raise handle_in_use(handle)
        key = SessionKey(self.number, handle)
        if key in self._kept:  # another stream goes on with the session that was opened here by this handle
            raise handle_in_use(handle)
        if event.event_seq != 1:
            raise sequence_gap(event.event_seq, 1)
        if len(self._entries) >= limits.max_sessions_per_stream:
            raise too_many_sessions(len(self._entries), limits.max_sessions_per_stream)
        if event.open.resume_token:
            self._resume(event, now)
            return None
        if not self.accepts_opens:
            raise draining()
        model = self._models.find(event.open.model_id)
        bucket = TokenBucket(limits.events_per_second, now)
        asked = int(event.open.priority)
        place = self.peer.place(Priority(asked) if asked in tuple(Priority) else Priority.NEAR, now)
        entry = SessionEntry(key, model, event.open.request_id, bucket, self, handle, place)
        entry.token = secrets.token_urlsafe(TOKEN_BYTES) if self._kept.grace_s else ""
        self._entries[handle] = self._by_key[key] = entry
        return entry

    def _resume(self, event: session_pb2.SessionEvent, now: float) -> None:
        """Take over a session that another stream carries, or carried. Raises EventRefused."""
        check_resume(event.open)
        entry, point = self._kept.find(event.open.resume_token), event.open.resume_point
        if entry is None:
            raise session_not_kept()
        if point.attempt <= entry.attempt:
            raise resume_superseded(point.attempt, entry.attempt)
        self._take_token(entry, now)
        if isinstance(entry.carrier, Stream):
            entry.carrier._give_away(entry)
        self._kept.move(entry, self, event.session)
        self._entries[event.session] = self._by_key[entry.key] = entry
        entry.confirm(point.answered_seq)
        entry.attempt, entry.is_resuming = point.attempt, True
        if entry.closed is not None:
            self._welcome_back(entry, point.next_frame)
        else:
            resume = Resume(entry.key, 0, now, point.attempt, point.next_frame, point.plan)
            entry.model.engine.submit(resume)

    def _give_away(self, entry: SessionEntry) -> None:
        """Another stream has taken over a session of this one, whose client may still be there."""
        self._remove(entry)
        address, message = SessionKey(self.number, entry.handle), "another stream has resumed the session"
        self.send_queue.put(Closed(address, CloseReason.TAKEN_OVER, Code.OK, message, 0, 0), entry.applied_seq)
        self.ready.set()

    def _remove(self, entry: SessionEntry) -> None:
        del self._entries[entry.handle]
        del self._by_key[entry.key]
        if not self._entries:
            self.empty_since = time.monotonic()

    def _take_token(self, entry: SessionEntry, now: float) -> None:
        if not entry.bucket.take(now):
            raise too_fast(self._limits.events_per_second, entry.bucket.wait_s)

    # ---- from the engine --------------------------------------------------------------------------------------------

    def take(self, *outputs: Output) -> None:
        """Take outputs for this stream's client, in order."""
        self.take_all(outputs)

    def take_now(self, *outputs: Output) -> None:
        """Take outputs for this stream's client, which do not wait for the flush interval."""
        self.take_all(outputs)
        self.urgent.set()

    def take_all(self, outputs: Iterable[Output]) -> None:
        """Take outputs for this stream's client, in order, and keep the books of their sessions."""
        for said in outputs:
            entry = self._by_key.get(said.session)
            if isinstance(said, Chunk | PlanNotice):
                if entry is None or entry.muted or entry.is_resuming:
                    continue
                self._put(said, entry)
            elif entry is None:
                self.send_queue.put(said, 0)
            elif isinstance(said, Resumed):
                self._go_on(said, entry)
            else:
                self._book(said, entry)
        self._check_backlog()
        self.ready.set()

    def _put(self, said: Output, entry: SessionEntry) -> None:
        """Queue what is said of a session, by the handle that it has here."""
        if entry.key.handle != entry.handle:
            said = replace(said, session=SessionKey(self.number, entry.handle))
        if isinstance(said, Chunk):
            self.send_queue.put_chunk(said, entry.applied_seq)
        else:
            self.send_queue.put(said, entry.applied_seq)

    def _book(self, said: Output, entry: SessionEntry) -> None:
        """Note what is said of a session, and tell it, unless that has to wait until the session is resumed."""
        if isinstance(said, Closed):
            refuse_waiting(entry)  # before the end is told and the handle can be used again
        noted = entry.note(said)
        if entry.is_resuming:
            if isinstance(said, Closed):  # it crossed the resume, which nobody will answer
                self._welcome_back(entry, 0)
            return
        if isinstance(noted, Opened):
            self._kept.add(entry)
        elif isinstance(noted, Closed):
            self._end(entry)
        elif isinstance(noted, Outcome) and noted.event_seq == 1:  # a refused OpenSession: the handle is unused
            if noted.code is Code.RESOURCE_EXHAUSTED:
                self._stream_metrics.reject(noted.reason)
            refuse_waiting(entry)
            self._end(entry)
        self._put(noted, entry)

    def _end(self, entry: SessionEntry) -> None:
        self._kept.forget(entry)
        self._remove(entry)

    def _go_on(self, resumed: Resumed, entry: SessionEntry) -> None:
        """The engine has taken up a resume: what follows are the frames that the client lacks."""
        if resumed.attempt != entry.attempt:
            return  # a later one is on its way
        if resumed.start_frame is not None:
            self._welcome_back(entry, resumed.start_frame)
            return
        self._stream_metrics.count_resume("refused")
        self._remove(entry)
        self._kept.park(entry)  # it ends with its grace, unless the client finds out where it is
        self._say(resume_out_of_range().outcome(SessionKey(self.number, entry.handle), 1), None)

    def _welcome_back(self, entry: SessionEntry, start_frame: int) -> None:
        """Tell a client that has resumed a session all that it may not have heard."""
        entry.is_resuming = False
        self._stream_metrics.count_resume("resumed")
        if entry.closed is not None:
            self._end(entry)
        for said in entry.welcome_back(start_frame):
            self._put(said, entry)
        self.ready.set()

    def _say(self, outcome: Outcome, entry: SessionEntry | None) -> None:
        """Answer an event that is none of its session's."""
        self.send_queue.put(outcome, entry.applied_seq if entry is not None else 0)
        self._check_backlog()
        self.ready.set()

    def next_response(self) -> bytes | None:
        """The next StreamMotionResponse to write: pongs and goodbyes first, then updates of many sessions in one."""
        self._room.set()
        if self.responses:
            return self.responses.popleft().SerializeToString()
        waiting = self.send_queue.take(MAX_RESPONSE_BYTES)
        self._check_backlog()
        if not waiting:
            return None
        return response_of(waiting)

    def reply(self, response: service_pb2.StreamMotionResponse) -> None:
        """Send a message that belongs to no session ahead of the updates."""
        self.responses.append(response)
        self.urgent.set()
        self.ready.set()

    def probe(self) -> asyncio.Future[None]:
        """Done once something more has been written: the client has finished, and its transport is not lost."""
        self._probe = asyncio.get_running_loop().create_future()
        self.reply(service_pb2.StreamMotionResponse())
        return self._probe

    def note_written(self) -> None:
        """What `next_response` gave last was written."""
        if self._probe is not None and not self.responses and not self._probe.done():
            self._probe.set_result(None)

    async def room(self) -> None:
        """Let other streams have a turn, and wait until this one may be read on, or ends.

        Not while it owes for what it has sent, nor while more answers wait than its client reads. Not reading on passes
        the wait to the client, by gRPC's own flow control.
        """
        await asyncio.sleep(0)
        while not self.ended:
            owed_s = self.budget.owed_s(time.monotonic())
            if not owed_s and not self._is_backlogged:
                return
            self._room.clear()
            timer = asyncio.get_running_loop().call_later(owed_s, self._room.set) if owed_s else None
            await self._room.wait()
            if timer is not None:
                timer.cancel()

    @property
    def _is_backlogged(self) -> bool:
        full = self.send_queue.num_bytes > self._limits.hard_backlog_bytes
        return full or len(self.responses) > MAX_WAITING_REPLIES

    # ---- ends -------------------------------------------------------------------------------------------------------

    def _check_backlog(self) -> None:
        """Close every session when the client reads too slowly: too much unsent at once, or a lot for too long."""
        waiting = self.send_queue.num_bytes
        if self.send_queue.dropped_frames > self._dropped_told:
            self._stream_metrics.drop_frames(self.send_queue.dropped_frames - self._dropped_told)
            self._dropped_told = self.send_queue.dropped_frames
        self._patience.check(waiting)

    def _give_up_on_reader(self) -> None:
        if any(not entry.muted for entry in self._entries.values()):
            self._stream_metrics.give_up_on_reader()
        for entry in self._entries.values():
            entry.muted = True
        self.send_queue.drop_frames()
        self.close_all(CloseReason.SLOW_READER)

    def close_all(self, reason: CloseReason, model: LoadedModel | None = None) -> int:
        """Ask for every session of the stream to be closed that is not closing already; returns how many those were.

        model: those that were opened with this one only.
        """
        now, asked = time.monotonic(), 0
        for entry in list(self._entries.values()):
            if model is not None and entry.model is not model:
                continue
            refuse_waiting(entry)  # the first may be the OpenSession itself, which is then refused
            if entry.known_to_engine and not entry.closing:
                entry.closing = True
                entry.model.engine.submit(Close(entry.key, entry.last_seq + 1, now, reason))
                asked += 1
        return asked

    def lose(self) -> None:
        """The transport is gone: keep the sessions that can be resumed, close the others, and write nothing more."""
        for entry in list(self._entries.values()):
            # One that its client has not heard of, or does not read, or that the server ends, is not gone on with.
            if entry.opened is not None and not entry.muted and not self.ended and self._kept.park(entry):
                self._remove(entry)
        self.close_all(CloseReason.CLIENT)
        for entry in self._entries.values():
            entry.place.release()
        self.end()
        self._patience.end()

    def refuse(self, refusal: StreamRefused) -> None:
        """End the stream for what its client does, or does not: its sessions too, and what waits is not written."""
        self.refusal = refusal
        self.end()
        self.lose()
        self.send_queue.clear()
        self.responses.clear()
        self.cut()

    def end(self) -> None:
        """Let the write loop finish what is there and stop."""
        self.ended = True
        self._room.set()
        self.urgent.set()
        self.ready.set()
