"""KeptSessions: finds sessions by their resume tokens, and keeps those whose clients have lost their connection."""

from __future__ import annotations

import asyncio
import heapq
import logging
import secrets
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial

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
from motiongen_server.rpc.budgets.waiting_memory import freed_by
from motiongen_server.rpc.sessions.durability import Durability
from motiongen_server.rpc.sessions.entry import Carrier, SessionEntry
from motiongen_server.rpc.sessions.event_path import close, end_waiting, refuse_waiting, without_needless_refusals
from motiongen_server.rpc.sessions.kept_answers import KeptAnswers
from motiongen_server.rpc.stream_metrics import NoStreamMetrics, StreamMetrics

_log = logging.getLogger(__name__)


class KeptSessions:
    """The sessions of all streams that can be resumed. Used from the event loop only.

    A session whose connection is lost is *parked*: its output goes to no client, its entry is kept up to date, and the
    engine continues until it has made the look-ahead. It counts for every limit as before. After grace_s it is closed.
    """

    def __init__(
        self, grace_s: float, stream_metrics: StreamMetrics | None = None, durability: Durability | None = None
    ) -> None:
        """grace_s: how long a session is kept; 0: not at all. durability: saves sessions in the store, if any."""
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
        """Roughly what sessions without a stream hold: events that wait, and what is kept to be sent again."""
        return sum(entry.held_bytes for entry in list(self._away.values()) if isinstance(entry.carrier, _Nobody))

    @property
    def can_resume(self) -> bool:
        """Whether sessions can be resumed at all: here after the loss of a connection, or from the store."""
        return bool(self.grace_s) or self.durability is not None

    def __contains__(self, key: SessionKey) -> bool:
        """Whether a session of this name exists, but not on the stream on which it was opened."""
        return key in self._away

    @property
    def has_away(self) -> bool:
        """Whether any session is not on the stream on which it was opened."""
        return bool(self._away)

    def carrier_of(self, key: SessionKey) -> Carrier | None:
        """The carrier of a session that is not on the stream on which it was opened; None for all others."""
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
        """The same, but older tokens that are still valid count too: see `Durability.held`."""
        entry = self.find(token)
        return self.durability.held(token) if entry is None and self.durability is not None else entry

    def save(self, entry: SessionEntry, taken: SnapshotTaken) -> None:
        """The engine has taken a snapshot of a session."""
        if self.durability is not None:
            self.durability.save(entry, taken)

    def park(self, entry: SessionEntry) -> bool:
        """Keep a session until its client comes back, for at most grace_s. Returns False if it cannot be kept."""
        if entry.token not in self._by_token or not self.grace_s:
            return False
        entry.carrier = _Nobody(entry, self)
        entry.is_resuming = False
        self._away[entry.key] = entry
        self._timers[entry.key] = asyncio.get_running_loop().call_later(self.grace_s, self._give_up, entry)
        return True

    def see_out(self, entry: SessionEntry) -> None:
        """A session is being closed and its stream has gone: let nobody resume it, and wait for its end."""
        self._by_token.pop(entry.token, None)
        if entry.known_to_engine and entry.closed is None:
            entry.carrier = _Nobody(entry, self)
            self._away[entry.key] = entry

    def end(self, entry: SessionEntry) -> None:
        """Close a session at once that no stream carries and that cannot be kept."""
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
        """A session is over, and its client has been told, or will not come back."""
        self._stop_timer(entry)
        self._by_token.pop(entry.token, None)
        self._away.pop(entry.key, None)
        entry.place.release()
        if self.durability is not None:
            self.durability.end(entry)

    def close_parked(self, reason: CloseReason, model: LoadedModel | None = None) -> int:
        """Close all parked sessions, or only those of one model; returns their number."""
        parked = [self._away[key] for key in self._timers]
        chosen = [entry for entry in parked if not entry.closing and model in (None, entry.model)]
        for entry in chosen:
            close(entry, reason, time.monotonic())
        return len(chosen)

    def by_peer(self) -> dict[str, list[SessionEntry]]:
        """Parked sessions by the peer that they count for, the smallest first."""
        of_peers: defaultdict[str, list[SessionEntry]] = defaultdict(list)
        for entry in sorted((self._away[key] for key in self._timers), key=lambda entry: entry.held_bytes):
            of_peers[entry.place.peer.name].append(entry)
        return of_peers

    def let_go(self, num_bytes: int, sure_bytes: int) -> None:
        """Free that many bytes, as far as parked sessions hold more than sure_bytes: of the peer that has the most, the
        one that holds the most gives first.

        Placements and warnings are dropped first, so that a client that resumes still learns what became of its events.
        If that is not enough, sessions are given up: resumes are refused as if grace_s had passed.
        """
        num_bytes = min(num_bytes, self.num_waiting_bytes - sure_bytes)
        num_bytes = self._freed(SessionEntry.let_go_of_places, num_bytes)
        self._freed(self._give_up_for_room, num_bytes)

    def _freed(self, free: Callable[[SessionEntry], None], num_bytes: int) -> int:
        """Have sessions free that many bytes. Returns how many are still to be freed."""
        of_peers = self.by_peer()
        most = [(-sum(entry.held_bytes for entry in entries), name) for name, entries in of_peers.items()]
        heapq.heapify(most)
        while most and num_bytes > 0:
            total, name = heapq.heappop(most)
            entry = of_peers[name].pop()
            freed = freed_by(entry, partial(free, entry))
            num_bytes -= freed
            if of_peers[name]:
                heapq.heappush(most, (total + freed, name))
        return num_bytes

    def _give_up_for_room(self, entry: SessionEntry) -> None:
        self._give_up(entry, "let_go")
        entry.answers = KeptAnswers()  # no client will come back for them

    def _give_up(self, entry: SessionEntry, how: str = "expired") -> None:
        """The client did not come back in time, or there is no memory to wait for it."""
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
    """Carries a session without a stream: keeps its entry up to date. Drops frames, which the engine sends again."""

    work = nullcontext()  # charged to nobody: what the client had asked for before it went

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
                self._entry.place.release()  # its client may take long to come back and learn of the end
            self._entry.note(said)
            # A refused open leaves nothing to resume. A session that is being taken over from another server can be
            # parked before its engine has answered the open.
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
