"""One stream: its sessions by handle, the order of their events, and what it still has to send."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.engine.types import (
    Chunk,
    Close,
    Closed,
    CloseReason,
    Code,
    Open,
    Opened,
    Outcome,
    Output,
    PlanNotice,
    Priority,
    SessionKey,
)
from motiongen_server.engine.types.refusals import (
    draining,
    handle_in_use,
    session_closed,
    session_not_open,
    too_many_pending,
)
from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.budget import REFUSAL_COST, StreamBudget
from motiongen_server.rpc.convert import (
    UNENCODED,
    Parts,
    append_frames,
    append_plan,
    append_update,
    engine_event,
    playhead_of,
    prompt_texts,
    warnings_of,
    write_update,
)
from motiongen_server.rpc.encoding import encoded
from motiongen_server.rpc.event_errors import (
    internal,
    invalid_event_seq,
    sequence_gap,
    too_fast,
    too_many_sessions,
)
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.peers import Peer
from motiongen_server.rpc.send_queue import Run, SendQueue
from motiongen_server.rpc.session_entry import SessionEntry
from motiongen_server.rpc.stream_metrics import NoStreamMetrics, StreamMetrics
from motiongen_server.rpc.token_bucket import TokenBucket

_log = logging.getLogger(__name__)

MAX_RESPONSE_BYTES = 1 << 20
MAX_WAITING_REPLIES = 64
MAX_WAITING_EVENTS = 64
"""Events of one session that may wait for a prompt to be encoded."""

Embeddings = dict[str, NDArray[np.float32]]


class Stream:
    """The state of one StreamMotion call. Everything here runs on the event loop."""

    def __init__(
        self,
        number: int,
        models: ModelRegistry,
        stream_metrics: StreamMetrics | None = None,
        peer: Peer | None = None,
    ) -> None:
        """peer: whom it is charged to besides; one of its own by default."""
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
        self._entries: dict[int, SessionEntry] = {}
        self._patience: asyncio.TimerHandle | None = None  # runs while more waits than may wait for long
        self._room = asyncio.Event()

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
            self._pass_on(entry, event, now)
        except EventRefused as refusal:
            self.budget.charge(REFUSAL_COST, now)
            self.take(refusal.outcome(entry.key, event.event_seq))
        except Exception as error:
            self._internal_error(entry, event.event_seq, error)

    def _report(self, event: session_pb2.SessionEvent, entry: SessionEntry | None, now: float) -> None:
        """Pass a playhead on, past whatever waits: it is about now. Raises EventRefused."""
        if entry is None:
            return  # it crossed the session's end
        if event.event_seq:
            raise invalid_event_seq(event.event_seq)
        self._take_token(entry, now)
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
        if not self.accepts_opens:
            raise draining()
        if event.event_seq != 1:
            raise sequence_gap(event.event_seq, 1)
        if len(self._entries) >= limits.max_sessions_per_stream:
            raise too_many_sessions(len(self._entries), limits.max_sessions_per_stream)
        key = SessionKey(self.number, handle)
        model = self._models.find(event.open.model_id)
        asked = event.open.priority
        place = self.peer.place(Priority(asked) if int(asked) in tuple(Priority) else Priority.NEAR)
        entry = SessionEntry(key, model, event.open.request_id, TokenBucket(limits.events_per_second, now), place)
        self._entries[handle] = entry
        return entry

    def _take_token(self, entry: SessionEntry, now: float) -> None:
        if not entry.bucket.take(now):
            raise too_fast(self._limits.events_per_second, entry.bucket.wait_s)

    def _pass_on(self, entry: SessionEntry, event: session_pb2.SessionEvent, now: float) -> None:
        """Submit at once if nothing of the session waits and its prompts are known, else queue behind the encoder."""
        texts = prompt_texts(event, entry.model.catalog)
        if not entry.waiting and entry.encoding is None:
            known = self._known_embeddings(entry.model, texts)
            if known is not None:
                self._submit(entry, event, now, known)
                return
        if len(entry.waiting) >= MAX_WAITING_EVENTS and event.WhichOneof("event") != "close":
            raise too_many_pending("events", MAX_WAITING_EVENTS)
        # All that can be wrong with it is found before anything is encoded for it, or waits.
        checked = engine_event(event, entry.key, now, UNENCODED, entry.model.catalog)
        if isinstance(checked, Open) and (refusal := entry.model.engine.refusal_of(checked)) is not None:
            self.budget.charge(REFUSAL_COST, now)
            self.take(refusal)
            return
        kept = session_pb2.SessionEvent()
        kept.CopyFrom(event)  # else the whole message would be kept with it
        entry.waiting.append((kept, now, texts))
        if entry.encoding is None:
            entry.encoding = asyncio.get_running_loop().create_task(self._encode_waiting(entry))

    def _known_embeddings(self, model: LoadedModel, texts: Sequence[str]) -> Embeddings | None:
        known = {}
        for text in texts:
            embedding = model.prompts.cached(text)
            if embedding is None:
                return None
            known[text] = embedding
        return known

    async def _encode_waiting(self, entry: SessionEntry) -> None:
        try:
            while entry.waiting:
                # It stays while it is encoded, so that `_refuse_waiting` finds it.
                event, received_at, texts = entry.waiting[0]
                embeddings: Embeddings = {}
                failure: Exception | None = None
                try:
                    for text in () if entry.closing else texts:
                        embeddings[text] = await encoded(entry.model.prompts, text, self.number, self.peer)
                except Exception as error:
                    failure = error
                if not entry.waiting or entry.waiting[0][0] is not event:
                    return  # its session ended meanwhile, and it was answered
                entry.waiting.popleft()
                try:
                    if failure is not None:
                        raise failure
                    self._submit(entry, event, received_at, embeddings)
                except EventRefused as refusal:
                    self.take(refusal.outcome(entry.key, event.event_seq))
                except Exception as error:
                    self._internal_error(entry, event.event_seq, error)
        finally:
            if entry.encoding is asyncio.current_task():
                entry.encoding = None
            self.ready.set()

    def _refuse_waiting(self, entry: SessionEntry) -> None:
        """Answer what waits for the encoder: its session is over."""
        if entry.encoding is not None and entry.encoding is not asyncio.current_task():
            entry.encoding.cancel()
        waiting, entry.waiting = entry.waiting, deque()
        for event, *_ in waiting:
            self.take(session_closed().outcome(entry.key, event.event_seq))

    def _submit(
        self, entry: SessionEntry, message: session_pb2.SessionEvent, now: float, embeddings: Embeddings
    ) -> None:
        if entry.closing:
            raise session_closed()
        event = engine_event(message, entry.key, now, embeddings, entry.model.catalog)
        warnings = warnings_of(message, event, entry.model.catalog)
        if warnings:
            entry.warnings[message.event_seq] = warnings
        entry.closing = isinstance(event, Close)
        entry.known_to_engine = True
        refusal = entry.model.engine.submit(event)
        if refusal is not None:
            self.take(refusal)
            self.urgent.set()

    def _internal_error(self, entry: SessionEntry, event_seq: int, error: Exception) -> None:
        error_id = secrets.token_hex(4)
        _log.error("event failed, error id %s", error_id, exc_info=error)
        self.take(internal(error_id).outcome(entry.key, event_seq))

    # ---- from the engine --------------------------------------------------------------------------------------------

    def take(self, *outputs: Output) -> None:
        """Take outputs for this stream's client, in order."""
        self.take_all(outputs)

    def take_all(self, outputs: Iterable[Output]) -> None:
        """Take outputs for this stream's client, in order, and keep the books of their sessions."""
        for said in outputs:
            entry = self._entries.get(said.session.handle)
            output = said if entry is None else entry.with_warnings(said)
            if entry is not None and entry.muted and isinstance(output, Chunk | PlanNotice):
                continue
            if isinstance(output, Chunk):
                self.send_queue.put_chunk(output, entry.applied_seq if entry is not None else 0)
                continue
            if entry is not None:
                self._book(output, entry)
            self.send_queue.put(output, entry.applied_seq if entry is not None else 0)
        self._check_backlog()
        self.ready.set()

    def _book(self, output: Output, entry: SessionEntry) -> None:
        """Note what an output says about its session, before it is told."""
        if isinstance(output, Opened):
            entry.answer(1)
        elif isinstance(output, Outcome) and output.event_seq:
            entry.answer(output.event_seq)
            if output.event_seq == 1:  # an OpenSession has an outcome only when it is refused: the handle is unused
                if output.code is Code.RESOURCE_EXHAUSTED:
                    self._stream_metrics.reject(output.reason)
                self._refuse_waiting(entry)
                self._forget(entry)
        elif isinstance(output, Closed):
            self._refuse_waiting(entry)  # before the end is told and the handle can be used again
            entry.applied_seq = entry.last_seq
            self._forget(entry)

    def _forget(self, entry: SessionEntry) -> None:
        del self._entries[entry.key.handle]
        entry.place.release()
        if not self._entries:
            self.empty_since = time.monotonic()

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
        response: Parts = []
        for item in waiting:
            if isinstance(item, Run):
                append_frames(
                    response, item.handle, item.applied_seq, item.plan, item.first_frame, item.parts, item.committed_to
                )
                continue
            # The number as of then: since, later events may have been answered in later updates.
            output, applied_seq = item
            if isinstance(output, PlanNotice):
                append_plan(response, applied_seq, output)
            else:
                update = session_pb2.SessionUpdate(session=output.session.handle, applied_seq=applied_seq)
                write_update(update, output)
                append_update(response, update)
        return b"".join(response)

    def reply(self, response: service_pb2.StreamMotionResponse) -> None:
        """Send a message that belongs to no session ahead of the updates."""
        self.responses.append(response)
        self.urgent.set()
        self.ready.set()

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
        limits, waiting = self._limits, self.send_queue.num_bytes
        if self.send_queue.dropped_frames > self._dropped_told:
            self._stream_metrics.drop_frames(self.send_queue.dropped_frames - self._dropped_told)
            self._dropped_told = self.send_queue.dropped_frames
        if waiting > limits.hard_backlog_bytes:
            self._give_up_on_reader()
        elif waiting <= limits.soft_backlog_bytes:
            self._end_patience()
        elif self._patience is None:
            self._patience = asyncio.get_running_loop().call_later(limits.backlog_s, self._give_up_on_reader)

    def _end_patience(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def _give_up_on_reader(self) -> None:
        self._end_patience()
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
            self._refuse_waiting(entry)  # the first may be the OpenSession itself, which is then refused
            if entry.known_to_engine and not entry.closing:
                entry.closing = True
                entry.model.engine.submit(Close(entry.key, entry.last_seq + 1, now, reason))
                asked += 1
        return asked

    def abandon(self) -> None:
        """The client is gone: close everything and write nothing more."""
        self.close_all(CloseReason.CLIENT)
        self.end()
        self._end_patience()
        for entry in self._entries.values():
            entry.place.release()

    def refuse(self, refusal: StreamRefused) -> None:
        """End the stream for what its client does, or does not. What waits is not written."""
        self.refusal = refusal
        self.abandon()
        self.send_queue.clear()
        self.responses.clear()
        self.cut()

    def end(self) -> None:
        """Let the write loop finish what is there and stop."""
        self.ended = True
        self._room.set()
        self.urgent.set()
        self.ready.set()
