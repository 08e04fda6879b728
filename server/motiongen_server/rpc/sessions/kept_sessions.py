"""KeptSessions: every session by the token that resumes it, and those whose client has lost its transport."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from contextlib import nullcontext

from motiongen_server.engine.types import (
    Chunk,
    Closed,
    CloseReason,
    Code,
    Outcome,
    Output,
    PlanNotice,
    Resumed,
    SessionKey,
    SnapshotTaken,
)
from motiongen_server.models.registry import LoadedModel
from motiongen_server.rpc.sessions.durability import Durability
from motiongen_server.rpc.sessions.entry import Carrier, SessionEntry
from motiongen_server.rpc.sessions.event_path import close, end_waiting, refuse_waiting, without_needless_refusals
from motiongen_server.rpc.sessions.kept_answers import KeptAnswers
from motiongen_server.rpc.stream_metrics import NoStreamMetrics, StreamMetrics

_log = logging.getLogger(__name__)


class KeptSessions:
    """The sessions of all streams that can be resumed. Used from the event loop only.

    A session whose transport is lost is *parked*: nobody hears of it, its books are kept, and the engine goes on until
    it has made a look-ahead of frames. It counts for every limit as before. After the grace it is closed.
    """

    def __init__(
        self, grace_s: float, stream_metrics: StreamMetrics | None = None, durability: Durability | None = None
    ) -> None:
        """grace_s: for which a session is kept; 0: none is. durability: of what outlives the process; None: nothing."""
        self.grace_s = grace_s
        self.durability = durability
        self._stream_metrics = stream_metrics or NoStreamMetrics()
        self._by_token: dict[str, SessionEntry] = {}
        self._away: dict[SessionKey, SessionEntry] = {}
        self._timers: dict[SessionKey, asyncio.TimerHandle] = {}

    @property
    def num_parked(self) -> int:
        """Sessions that wait for their client."""
        return len(self._timers)

    @property
    def num_waiting_bytes(self) -> int:
        """What is held of sessions that no stream carries, about: of events that wait, and to be told again."""
        return sum(entry.held_bytes for entry in list(self._away.values()) if isinstance(entry.carrier, _Nobody))

    @property
    def can_resume(self) -> bool:
        """Whether a session can be resumed at all: here after the loss of a transport, or out of the store."""
        return bool(self.grace_s) or self.durability is not None

    def __contains__(self, key: SessionKey) -> bool:
        """Whether a session of this name lives elsewhere than on the stream that it was opened on."""
        return key in self._away

    @property
    def has_away(self) -> bool:
        """Whether any session is not on the stream it was opened on."""
        return bool(self._away)

    def carrier_of(self, key: SessionKey) -> Carrier | None:
        """Who tells of a session that is not on the stream it was opened on; None for all others."""
        entry = self._away.get(key)
        return None if entry is None else entry.carrier

    def add(self, entry: SessionEntry) -> None:
        """A session has been opened, and can be resumed if it has a token."""
        if entry.token:
            self._by_token[entry.token] = entry

    def find(self, token: str) -> SessionEntry | None:
        """The session that a token resumes, parked or not."""
        return self._by_token.get(token)

    def resumed_by(self, token: str) -> SessionEntry | None:
        """The same, also by a token older than its own that is good still: see `Durability.held`."""
        entry = self.find(token)
        return self.durability.held(token) if entry is None and self.durability is not None else entry

    def save(self, entry: SessionEntry, taken: SnapshotTaken) -> None:
        """The engine has taken a snapshot of a session."""
        if self.durability is not None:
            self.durability.save(entry, taken)

    def park(self, entry: SessionEntry) -> bool:
        """Keep a session until its client comes back, or for as long as the grace lasts. False: it cannot be."""
        if entry.token not in self._by_token or not self.grace_s:
            return False
        entry.carrier = _Nobody(entry, self)
        entry.is_resuming = False
        self._away[entry.key] = entry
        self._timers[entry.key] = asyncio.get_running_loop().call_later(self.grace_s, self._give_up, entry)
        return True

    def see_out(self, entry: SessionEntry) -> None:
        """A session is being closed, and its stream has gone: nobody resumes it, and its end is awaited."""
        self._by_token.pop(entry.token, None)
        if entry.known_to_engine and entry.closed is None:
            entry.carrier = _Nobody(entry, self)
            self._away[entry.key] = entry

    def end(self, entry: SessionEntry) -> None:
        """A session that no stream carries, and that cannot be kept, is closed at once."""
        self._stop_timer(entry)
        entry.place.release()
        self.see_out(entry)
        if entry.known_to_engine and not entry.closing:
            close(entry, CloseReason.CLIENT, time.monotonic())

    def move(self, entry: SessionEntry, carrier: Carrier, handle: int) -> None:
        """Another stream carries a session from now on."""
        self._stop_timer(entry)
        entry.carrier, entry.handle = carrier, handle
        self._away[entry.key] = entry

    def forget(self, entry: SessionEntry) -> None:
        """A session is over, and its client has been told, or will not come to hear it."""
        self._stop_timer(entry)
        self._by_token.pop(entry.token, None)
        self._away.pop(entry.key, None)
        entry.place.release()
        if self.durability is not None:
            self.durability.end(entry)

    def close_parked(self, reason: CloseReason, model: LoadedModel | None = None) -> int:
        """Close the sessions that are parked, those of one model only if it is given; returns how many those were."""
        parked = [self._away[key] for key in self._timers]
        chosen = [entry for entry in parked if not entry.closing and model in (None, entry.model)]
        for entry in chosen:
            close(entry, reason, time.monotonic())
        return len(chosen)

    def let_go(self, num_bytes: int) -> None:
        """Free so many bytes, if parked sessions hold as many; those that hold most first.

        Placements and warnings go before anything else, so that a client that resumes still learns what became of its
        events. Where that is not enough sessions are given up: a resume is refused as after the grace.
        """
        parked = sorted((self._away[key] for key in self._timers), key=lambda entry: entry.held_bytes, reverse=True)
        for free in (SessionEntry.let_go_of_places, self._give_up_for_room):
            for entry in parked:
                if num_bytes <= 0:
                    return
                before = entry.held_bytes
                free(entry)
                num_bytes -= before - entry.held_bytes

    def _give_up_for_room(self, entry: SessionEntry) -> None:
        self._give_up(entry, "let_go")
        entry.answers = KeptAnswers()  # nobody comes to hear them

    def _give_up(self, entry: SessionEntry, how: str = "expired") -> None:
        """Nobody came back, or nobody can be waited for."""
        self._stop_timer(entry)
        self._by_token.pop(entry.token, None)
        if entry.closed is not None:
            self.forget(entry)
            return
        self._stream_metrics.count_resume(how)
        if not entry.closing:
            close(entry, CloseReason.CLIENT, time.monotonic())

    def _stop_timer(self, entry: SessionEntry) -> None:
        timer = self._timers.pop(entry.key, None)
        if timer is not None:
            timer.cancel()


class _Nobody:
    """Carries a parked session: keeps its books, and lets frames go, which the engine sends again."""

    work = nullcontext()  # nobody's: what its client had asked for before it went

    def __init__(self, entry: SessionEntry, kept: KeptSessions) -> None:
        self._entry = entry
        self._kept = kept

    def take(self, *outputs: Output) -> None:
        for said in without_needless_refusals(outputs, lambda _: self._entry):
            if isinstance(said, Chunk | PlanNotice | Resumed):
                continue
            if isinstance(said, SnapshotTaken):
                self._kept.save(self._entry, said)
                continue
            if isinstance(said, Closed):
                end_waiting(self._entry, said)
                self._entry.place.release()  # it may wait long for its client to come and hear of that
            self._entry.note(said)
            # A refused open leaves nothing to resume here, though its session was parked: one that was taken over is
            # from the moment on that its engine is asked.
            is_refused = isinstance(said, Outcome) and said.event_seq == 1 and said.code is not Code.OK
            if is_refused:
                refuse_waiting(self._entry)
            if is_refused or (isinstance(said, Closed) and self._kept.find(self._entry.token) is None):
                self._kept.forget(self._entry)

    def take_now(self, *outputs: Output) -> None:
        self.take(*outputs)

    def fail(self, error: Exception) -> None:
        _log.error("a session that no stream carries failed, error id %s", secrets.token_hex(4), exc_info=error)
        self._kept.end(self._entry)
