"""StreamSessions: the sessions that a stream carries, and the engine's output for them on its way to the client."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Chunk,
    Closed,
    Code,
    EventRefused,
    Opened,
    Outcome,
    Output,
    PlanNotice,
    Priority,
    Resumed,
    SessionKey,
    SnapshotTaken,
)
from motiongen_server.models.registry import LoadedModel
from motiongen_server.replicas.hint import OF_THIS_SERVER, OtherServer, RefusedOpen
from motiongen_server.rpc.budgets.loop_time import Work
from motiongen_server.rpc.convert import asked_steps
from motiongen_server.rpc.errors.events import resume_out_of_range
from motiongen_server.rpc.limits import Limits
from motiongen_server.rpc.sessions.entry import SessionEntry
from motiongen_server.rpc.sessions.event_path import end_waiting, refuse_waiting, without_needless_refusals
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.stream_metrics import StreamMetrics
from motiongen_server.rpc.streams.output import StreamOutput

_FRAMES_AND_PLANS = (Chunk, PlanNotice)  # a union would be built again for every output


class StreamSessions(StreamOutput):
    """The part of a `Stream` that takes engines' output. empty_since: monotonic seconds; valid while it has no session.

    other_servers: returns servers with room for a session of a model, as far as is known.
    """

    def __init__(
        self, number: int, limits: Limits, stream_metrics: StreamMetrics, kept: KeptSessions, work: Work
    ) -> None:
        super().__init__(limits, stream_metrics, work)
        self.number = number
        self.empty_since = time.monotonic()
        self.other_servers: Callable[[str], tuple[OtherServer, ...]] = lambda _: ()
        self._kept = kept
        self._entries: dict[int, SessionEntry] = {}  # by their handle on this stream
        self._by_key: dict[SessionKey, SessionEntry] = {}

    @property
    def num_sessions(self) -> int:
        return len(self._entries)

    @property
    def num_waiting_bytes(self) -> int:
        """Roughly the bytes that wait to be written, of events that wait for prompts, and kept to be sent again."""
        entries = list(self._entries.values())  # metrics are read on another thread
        return super().num_waiting_bytes + sum(entry.held_bytes for entry in entries)

    def take(self, *outputs: Output) -> None:
        """Take outputs for this stream's client, in order."""
        self.take_all(outputs)

    def take_now(self, *outputs: Output) -> None:
        """Take outputs for this stream's client that must not wait for the flush interval."""
        self.take_all(outputs)
        self.urgent.set()

    def take_all(self, outputs: Sequence[Output]) -> None:
        """Take outputs for this stream's client, in order, and update the entries of their sessions.

        A plan that answers edits does not wait for the flush interval, nor do the frames that come with it: a user who
        steers is waiting for them.
        """
        entries, answers_edits = self._by_key, False
        for said in without_needless_refusals(outputs, entries.get):
            entry = entries.get(said.session)
            if isinstance(said, _FRAMES_AND_PLANS):
                if entry is None or entry.muted or entry.is_resuming:
                    continue
                self._put(said, entry)
                answers_edits |= isinstance(said, PlanNotice) and bool(said.event_seqs)
            elif entry is None:
                self._pass_on(said)
            elif isinstance(said, SnapshotTaken):
                self._kept.save(entry, said)
            elif isinstance(said, Resumed):
                self._go_on(said, entry)
            else:
                with self.work:
                    self._book(said, entry)
        self._check_backlog()
        if answers_edits:
            self.urgent.set()
        self.ready.set()

    def _pass_on(self, said: Output) -> None:
        """Take an output for a session that this stream does not carry, or has not since the previous output."""
        carrier, this = self._kept.carrier_of(said.session), cast(object, self)
        if carrier is not None and carrier is not this:
            carrier.take(said)
        elif not isinstance(said, SnapshotTaken):
            self.send_queue.put(said, 0)

    def _put(self, said: Output, entry: SessionEntry) -> None:
        """Queue an output of a session, with the session's handle on this stream."""
        if entry.key.handle != entry.handle:
            said = replace(said, session=SessionKey(self.number, entry.handle))
        if isinstance(said, Chunk):
            entry.sent_to = max(entry.sent_to, said.first_frame + len(said.rows))
            lookahead = 0 if entry.opened is None else entry.opened.lookahead
            self.send_queue.put_chunk(said, entry.applied_seq, entry.coding, lookahead)
        else:
            if self.tracing is not None and isinstance(said, PlanNotice):
                self.tracing.announce(said, entry)
            self.send_queue.put(said, entry.applied_seq)

    def _book(self, said: Output, entry: SessionEntry) -> None:
        """Record an output of a session, and queue it unless that has to wait until the session is resumed."""
        if isinstance(said, Closed):  # before the end is told and the handle can be used again
            end_waiting(entry, said)
        noted = entry.note(said)
        if entry.is_resuming:
            if isinstance(said, Closed):  # it crossed the resume, which the engine will not answer
                self._welcome_back(entry, 0)
            elif isinstance(said, Outcome) and said.event_seq == 1:  # the engine refuses to continue from a snapshot
                self._stream_metrics.count_resume("refused")
                entry.is_resuming = False  # so that answers to what waits for the encoder are sent
                refuse_waiting(entry)
                self._end(entry)
                self._say(
                    replace(self._hinted(said, entry.model.model_id), session=SessionKey(self.number, entry.handle)),
                    None,
                )
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
            noted = self._hinted(noted, entry.model.model_id)
        self._put(noted, entry)

    def _turn_away(
        self, event: session_pb2.SessionEvent, model: LoadedModel, priority: Priority
    ) -> EventRefused | None:
        """Refuse an open for which there is no room, before reading the rest of it. Returns the refusal, if any.

        Clients that ask again and again must not disturb those that play.
        """
        facts = model.catalog.facts
        steps = asked_steps(event.open, facts)
        refusal = model.engine.refusal_of(priority, steps) if facts.min_steps <= steps <= facts.max_steps else None
        if refusal is None:
            return None
        if refusal.code is Code.RESOURCE_EXHAUSTED:
            self._stream_metrics.reject(refusal.reason)
        outcome = refusal.outcome(SessionKey(self.number, event.session), event.event_seq)
        self._say(self._hinted(outcome, model.model_id), None)
        return refusal

    def _hinted(self, refusal: Outcome, model_id: str) -> Outcome:
        """The refusal of an open; if it concerns this server only, with servers that have room for that model."""
        if refusal.reason not in OF_THIS_SERVER:
            return refusal
        return RefusedOpen.of(refusal, self.other_servers(model_id))

    def _end(self, entry: SessionEntry) -> None:
        self._kept.forget(entry)
        self._remove(entry)

    def _go_on(self, resumed: Resumed, entry: SessionEntry) -> None:
        """The engine has answered a resume: if it accepts, the frames that the client lacks follow."""
        if resumed.attempt != entry.attempt:
            return  # the answer to a later attempt is on its way
        if resumed.start_frame is not None:
            self._welcome_back(entry, resumed.start_frame, resumed.notice)
            return
        self._stream_metrics.count_resume("refused")
        self._remove(entry)
        if not self._kept.park(entry):  # parked, it ends after the grace unless the client resumes correctly
            self._kept.end(entry)
        self._say(resume_out_of_range().outcome(SessionKey(self.number, entry.handle), 1), None)

    def _welcome_back(self, entry: SessionEntry, start_frame: int, notice: PlanNotice | None = None) -> None:
        """Send a client that has resumed a session everything that it may have missed."""
        entry.is_resuming = False
        self._stream_metrics.count_resume("resumed")
        if entry.closed is not None:
            self._end(entry)
        for said in entry.welcome_back(start_frame, notice):
            self._put(said, entry)
        self.ready.set()

    def _say(self, outcome: Outcome, entry: SessionEntry | None) -> None:
        """Answer an event that does not count among its session's events."""
        self.send_queue.put(outcome, entry.applied_seq if entry is not None else 0)
        self._check_backlog()
        self.ready.set()

    def _remove(self, entry: SessionEntry) -> None:
        del self._entries[entry.handle]
        del self._by_key[entry.key]
        if not self._entries:
            self.empty_since = time.monotonic()
