"""One stream: its sessions by handle, the order of their events, and what becomes of them when the stream is lost."""

from __future__ import annotations

import time
from collections.abc import Callable

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Closed,
    CloseReason,
    Code,
    Outcome,
    Output,
    Priority,
    Resume,
    SessionKey,
)
from motiongen_server.engine.types.refusals import draining, handle_in_use, session_not_open
from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.identity.caller import ANYBODY
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.stream_budget import CONSTRAINT_COST, FREE, PATH_COST, REFUSAL_COST, RESUME_COST
from motiongen_server.rpc.budgets.token_bucket import TokenBucket
from motiongen_server.rpc.convert import check_resume, constraints_in, num_paths, playhead_of
from motiongen_server.rpc.errors.events import (
    gateway_overloaded,
    handle_away,
    invalid_event_seq,
    resume_superseded,
    sequence_gap,
    session_not_kept,
    too_fast,
    too_many_sessions,
)
from motiongen_server.rpc.errors.streams import stream_failed
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.sessions.durability import new_secret, token_of
from motiongen_server.rpc.sessions.entry import SessionEntry
from motiongen_server.rpc.sessions.event_path import (
    SESSION_CLOSED,
    ask_to_close,
    begin_end,
    pass_on,
    tell_internal_error,
)
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.stream_metrics import NoStreamMetrics, StreamMetrics
from motiongen_server.rpc.streams.take_overs import StreamTakeOvers


class Stream(StreamTakeOvers):
    """The state of one StreamMotion call. Everything here runs on the event loop."""

    def __init__(
        self,
        number: int,
        models: ModelRegistry,
        stream_metrics: StreamMetrics | None = None,
        kept: KeptSessions | None = None,
        peer: Peer | None = None,
    ) -> None:
        """kept: the sessions of all streams that can be resumed; by default none can.

        peer: is charged for what comes in, besides the stream; by default a peer of its own.
        """
        now = time.monotonic()
        metrics = stream_metrics or NoStreamMetrics()
        super().__init__(number, models, metrics, kept or KeptSessions(0), peer or Peer(PeerLimits(), now), now)
        self.began_at = now
        self.caller = ANYBODY
        self.goodbyes: set[int] = set()  # reasons that the client has been told
        self.flush_s = 0.0
        self.greeted = False  # both sides have said hello
        self.listening_since: float | None = None  # monotonic seconds, while it waits for a message of the client
        self.cut: Callable[[], object] = lambda: None  # ends the writing
        self.is_cut = False  # whether the writing ends with the present message
        self.refusal: StreamRefused | None = None  # why the stream is ended before its client has finished
        self._has_failed = False
        self.rtt_s: float | None = None  # the client's last measurement

    # ---- from the client --------------------------------------------------------------------------------------------

    def receive(self, event: session_pb2.SessionEvent, now: float, unread: EventRefused | None = None) -> None:
        """Take one event, read at `now` and already charged: pass it to its engine, or answer with a refusal.

        unread: the refusal, if its content was not parsed.
        """
        if self._held_back and event.session in self._held_back:
            self._hold_back(event, now, unread)
        else:
            self._receive(event, now, unread)

    def _receive(self, event: session_pb2.SessionEvent, now: float, unread: EventRefused | None) -> None:
        kind, handle = event.WhichOneof("event"), event.session
        entry = self._entries.get(handle)
        self.work.num_events += 1
        try:
            if unread is not None and (kind == "open" or entry is None):
                raise unread
            if kind == "playhead":
                self._report(event, entry, now)
                return
            entry = self._open(event, entry, now) if kind == "open" else self._next_of(event, entry)
        except EventRefused as refusal:
            # It never became an event of the session, so the session's entry must not count its number.
            outcome = refusal.outcome(SessionKey(self.number, handle), event.event_seq)
            if kind == "open" and refusal.code is Code.RESOURCE_EXHAUSTED:
                self._stream_metrics.reject(refusal.reason)
            self.budget.charge(REFUSAL_COST, now)
            self.work.num_refused += refusal.code not in FREE
            self._say(self._hinted(outcome, event.open.model_id or self._models.default.model_id), entry)
            return
        if entry is None or entry.is_leaving:  # its client sends the event again where the session continues
            return
        try:
            if unread is not None:
                raise unread
            if kind != "close":  # a close saves work
                self._take_token(entry, now)
            if kind == "open" and self.gateway_lag is not None and self.gateway_lag.is_too_long:
                raise gateway_overloaded(self.gateway_lag.lag_s)
            if kind in ("open", "edit_constraints"):
                told = constraints_in(event)
                self.budget.charge(CONSTRAINT_COST * len(told) + PATH_COST * num_paths(told), now)
            pass_on(entry, event, now)
        except EventRefused as refusal:
            self.work.num_refused += refusal.code not in FREE
            self.take(refusal.outcome(entry.key, event.event_seq))
        except Exception as error:
            tell_internal_error(entry, event.event_seq, error)

    def _report(self, event: session_pb2.SessionEvent, entry: SessionEntry | None, now: float) -> None:
        """Pass a playhead on, ahead of events that wait: it describes the present. Raises EventRefused."""
        if entry is None:
            return  # it crossed the session's end
        if event.event_seq:
            raise invalid_event_seq(event.event_seq)
        self._take_token(entry, now)
        entry.note_heard()
        report = event.playhead
        if report.answered_seq:
            entry.confirm(report.answered_seq)
        entry.note_shown(report.frame)
        if entry.known_to_engine and not entry.closing:
            entry.model.engine.submit(playhead_of(report, entry.key, now, self.rtt_s))

    def _next_of(self, event: session_pb2.SessionEvent, entry: SessionEntry | None) -> SessionEntry | None:
        """The session for which this is the next event; None if the event is to be dropped. Raises EventRefused."""
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
        if key in self._kept:
            raise handle_away(handle)
        if event.event_seq != 1:
            raise sequence_gap(event.event_seq, 1)
        num_on_their_way = sum(each not in self._entries for each in self._held_back)
        if len(self._entries) + num_on_their_way >= limits.max_sessions_per_stream:
            raise too_many_sessions(len(self._entries), limits.max_sessions_per_stream)
        if event.open.resume_token:
            self._resume(event, now)
            return None
        if self.ended or not self.accepts_opens:  # a stream that is ending is still read, without waits
            raise draining()
        model = self._models.find(event.open.model_id)
        asked = int(event.open.priority)
        priority = Priority(asked) if asked in tuple(Priority) else Priority.NEAR
        if (refusal := self._turn_away(event, model, priority)) is not None:
            self.budget.charge(0 if refusal.code in FREE else REFUSAL_COST, now)
            return None
        bucket, place = TokenBucket(limits.events_per_second, now), self.peer.place(priority, now)
        entry = SessionEntry(key, model, event.open.request_id, bucket, self, handle, place)
        entry.token = token_of(new_secret()) if self._kept.can_resume else ""
        self._entries[handle] = self._by_key[key] = entry
        return entry

    def _resume(self, event: session_pb2.SessionEvent, now: float) -> None:
        """Resume a session that another stream or server carries, or carried. Raises EventRefused."""
        check_resume(event.open)
        entry, point = self._kept.resumed_by(event.open.resume_token), event.open.resume_point
        if entry is None and self._kept.durability is not None:
            self._begin_take_over(event, self._kept.durability, now)
            return
        if entry is None or entry.place.peer.tenant != self.peer.tenant:  # tenants never learn of each other's
            raise session_not_kept()
        if point.attempt <= entry.attempt:
            raise resume_superseded(point.attempt, entry.attempt)
        self._take_token(entry, now)
        self.budget.charge(RESUME_COST, now)
        if isinstance(entry.carrier, Stream):
            entry.carrier._give_away(entry)
        self._kept.move(entry, self, event.session)
        self._entries[event.session] = self._by_key[entry.key] = entry
        entry.confirm(point.answered_seq)
        if event.open.resume_token == entry.token:
            entry.note_heard()
        entry.attempt, entry.is_resuming = point.attempt, True
        if entry.closed is not None:
            self._welcome_back(entry, point.next_frame)
        else:
            resume = Resume(entry.key, 0, now, point.attempt, point.next_frame, point.plan)
            entry.model.engine.submit(resume)

    def _give_away(self, entry: SessionEntry) -> None:
        """Another stream has taken over a session of this one; the client of this stream may still be there."""
        self._remove(entry)
        address, message = SessionKey(self.number, entry.handle), "another stream has resumed the session"
        self.send_queue.put(Closed(address, CloseReason.TAKEN_OVER, Code.OK, message, 0, 0), entry.applied_seq)
        self.ready.set()

    def _take_token(self, entry: SessionEntry, now: float) -> None:
        if not entry.bucket.take(now):
            raise too_fast(self._limits.events_per_second, entry.bucket.wait_s)

    def _book(self, said: Output, entry: SessionEntry) -> None:
        """Charges refusals of the engine too, but neither faults of the server's own nor ends of sessions."""
        if isinstance(said, Outcome) and said.code not in FREE and said.reason != SESSION_CLOSED:
            self.budget.charge(REFUSAL_COST, time.monotonic())
        super()._book(said, entry)

    # ---- ends -------------------------------------------------------------------------------------------------------

    def _give_up_on_reader(self) -> None:
        if any(not entry.muted for entry in self._entries.values()):
            self._stream_metrics.give_up_on_reader()
        for entry in self._entries.values():
            entry.muted = True
        self.send_queue.drop_frames()
        self.close_all(CloseReason.SLOW_READER)

    def close_all(self, reason: CloseReason, model: LoadedModel | None = None) -> int:
        """Ask engines to close all sessions that are not closing already; returns their number.

        model: only sessions that were opened with it.
        """
        now, asked = time.monotonic(), 0
        for entry in list(self._entries.values()):
            if model is not None and entry.model is not model:
                continue
            begin_end(entry, reason)
            if entry.known_to_engine and not entry.closing:
                ask_to_close(entry, reason, now)
                asked += 1
        return asked

    def lose(self) -> None:
        """The connection is lost: keep the sessions that can be resumed, close the others, and write nothing more."""
        for entry in list(self._entries.values()):
            # Not kept: sessions that the client does not know of or does not read, or that the server is ending.
            if entry.opened is not None and not entry.muted and not self.ended and self._kept.park(entry):
                self._remove(entry)
        self.close_all(CloseReason.CLIENT)
        for entry in list(self._entries.values()):
            entry.place.release()
            self._kept.see_out(entry)
            self._remove(entry)  # `kept` awaits its end now; the end of the call must not do so again
        self.end()
        self._patience.end()

    def refuse(self, refusal: StreamRefused) -> None:
        """End the stream for what its client did or failed to do: its sessions end, and what waits is not written."""
        self.refusal = refusal
        self.end()
        self._drop_line()

    def expire(self, refusal: StreamRefused) -> None:
        """End the stream; its client may come back and resume its sessions."""
        self.refusal = refusal
        self._drop_line()

    def fail(self, error: Exception) -> None:
        """End the stream because of a fault of the server's own, which is logged once.

        Its sessions are closed with the call: the fault may have left their entries inconsistent.
        """
        if not self._has_failed:
            self._has_failed = True
            self.refusal = stream_failed(self.number, error)
            self.end()
            self._forget_unsent()
            self.cut()

    def _drop_line(self) -> None:
        self._forget_unsent()  # otherwise the sessions' last messages might exceed the backlog once more
        self.lose()
        self._forget_unsent()
        self.cut()

    def _forget_unsent(self) -> None:
        self.send_queue.clear()
        self.responses.clear()
