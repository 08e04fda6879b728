"""Durability: the edge's side of snapshots: saves sessions, tells clients what is saved, and takes sessions over.

A session's token is `secret.epoch`: a secret, and the fencing epoch in which the token was issued. The record's name is
a hash of the secret, so nobody can resume a session with what the store holds. A server that takes a session over
issues a new token. The server that held it before does not know that token, and so never continues a session that has
moved elsewhere.

The answer with the new token may be lost, more than once, and the client then comes back with an older one. So a token
stays valid until the client is known to have a newer one: it has resumed with that, or has sent something to the server
that issued it. A token whose epoch is higher than the record's was never issued.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import secrets
from collections.abc import Callable, Iterable
from dataclasses import replace

from motiongen_server.engine.types import CloseReason, Code, Durable, SaveAgain, SnapshotTaken
from motiongen_server.rpc.sessions.entry import SessionEntry
from motiongen_server.rpc.sessions.event_path import close
from motiongen_server.rpc.sessions.store_turns import StoreAway, StoreTurns
from motiongen_server.snapshots.listener import Written
from motiongen_server.snapshots.record import RecordRefused, SessionRecord, read_record
from motiongen_server.snapshots.store import Held, Lease, SnapshotStore
from motiongen_server.snapshots.taker import SnapshotTaker
from motiongen_server.snapshots.writer import SnapshotWriter
from motiongen_server.text.turns import Asker

SECRET_BYTES = 24
MOST_SAVED_AGAIN = 256
"""How many sessions that the store has lost are saved again at a time, every `writer.RENEW_EVERY_S`. Each takes tenths
of a millisecond here and in its engine."""


class NotKept(Exception):
    """The store has nothing from which the session can continue; the message says why, for the log."""


def new_secret() -> str:
    """The secret of a new session, by which its client resumes it."""
    return secrets.token_urlsafe(SECRET_BYTES)


def token_of(secret: str, epoch: int = 1) -> str:
    """The token with which a client resumes the session."""
    return f"{secret}.{epoch}"


def lease_of(token: str) -> Lease:
    """The record that a token stands for, and the token's epoch. Raises NotKept if it is not a token of ours."""
    secret, _, epoch = token.rpartition(".")
    if not secret or not epoch.isascii() or not epoch.isdecimal() or len(epoch) > 12:
        raise NotKept("that is not a session's token")
    return Lease(hashlib.sha256(secret.encode()).hexdigest(), int(epoch))


class Durability:
    """Used on the event loop; the writer's thread calls it through the loop."""

    def __init__(self, store: SnapshotStore, loop: asyncio.AbstractEventLoop, count: Callable[[str], None]) -> None:
        """count: is called for every snapshot that was written, fenced or lost."""
        self._loop = loop
        self._count = count
        self._entries: dict[Lease, SessionEntry] = {}
        self._by_name: dict[str, SessionEntry] = {}  # the newest of each record
        self._taker = SnapshotTaker(store)
        self._turns = StoreTurns(loop.time)
        self.writer = SnapshotWriter(store, _OnLoop(self, loop))

    def save(self, entry: SessionEntry, taken: SnapshotTaken) -> None:
        """Save a session as its engine and the edge know it now."""
        if entry.opened is None or not entry.token or entry.closing:
            return
        lease = self._hold(entry) if entry.lease is None else entry.lease
        self.writer.save(lease, _record_of(entry, taken))

    def end(self, entry: SessionEntry) -> None:
        """A session is over here. Its record stays if it may continue elsewhere: after a drain, or an engine's loss."""
        lease, entry.lease = entry.lease, None
        if lease is None or self._let_go(lease) is None:
            return
        closed = entry.closed
        if closed is None or closed.reason is CloseReason.DRAINED or closed.code is Code.UNAVAILABLE:
            self.writer.release(lease)
        else:
            self.writer.drop(lease)

    async def take_over(
        self, token: str, tenant: str, asker: Asker, check: Callable[[SessionRecord], None]
    ) -> tuple[str, SessionRecord]:
        """Take a session over from another server; returns its new token and its record.

        check: raises if the session may not be taken over for other reasons. If anything is raised, the session stays
        with the server that has it. Raises NotKept, and EventRefused if the store is busy or does not answer, so that
        it is not known whether the session is kept.
        """
        name, epoch = lease_of(token)

        def read(found: Held) -> SessionRecord:
            record = _read(found, epoch, tenant)
            check(record)
            return record

        async def ask() -> tuple[str, SessionRecord]:
            held = None
            while held is None:  # None if it was taken since the read, perhaps for this client, whose answer was lost
                found = await asyncio.wrap_future(self._taker.read(name))
                if found is None:
                    raise NotKept("the store has no such session")
                read(found)
                held = await asyncio.wrap_future(self._taker.take(Lease(name, found.epoch)))
                self._turns.note_answer()  # not after the read: a full store can be read, but takes no writes
            return token_of(token.rpartition(".")[0], held.epoch), read(held)

        try:
            return await self._turns.take(asker, ask)
        except StoreAway as error:
            raise NotKept(str(error)) from error

    def adopt(self, entry: SessionEntry) -> None:
        """Hold a session that was taken over, and count it as saved: otherwise events that its client has sent since
        would be refused if the session moved on to another server before it is saved again."""
        self.writer.hold(self._hold(entry))
        entry.durable = Durable(entry.key, entry.last_seq, not self.writer.is_failing)

    def held(self, token: str) -> SessionEntry | None:
        """The session that this server took over, if the token is an older one that is still valid for it.

        Its client, which has sent nothing since, may not have received the new token, and then comes with the old one.
        """
        try:
            name, epoch = lease_of(token)
        except NotKept:
            return None
        entry = self._by_name.get(name)
        if entry is None or entry.lease is None or entry.closing or entry.closed is not None:
            return None
        return entry if entry.told_epoch <= epoch < entry.lease.epoch else None

    def _hold(self, entry: SessionEntry) -> Lease:
        """From now on this server writes the session's record."""
        entry.lease = lease = lease_of(entry.token)
        self._entries[lease] = self._by_name[lease.name] = entry
        return lease

    def _let_go(self, lease: Lease) -> SessionEntry | None:
        """Stop writing a record. Returns its session; None if there was none."""
        entry = self._entries.pop(lease, None)
        if entry is not None and self._by_name.get(lease.name) is entry:
            del self._by_name[lease.name]
        return entry

    def close(self) -> None:
        """Write what waits, for a moment at most, and end."""
        self._taker.close()
        self.writer.close()

    # ---- what the writer reports ------------------------------------------------------------------------------------

    def written(self, written: Iterable[Written]) -> None:
        """These records were written to the store."""
        for lease, taken_seq in written:
            self._count("written")
            self._tell(lease, taken_seq, is_kept=True)

    def renewed(self, leases: Iterable[Lease]) -> None:
        """These are still in the store."""
        for lease in leases:
            self._tell(lease, 0, is_kept=True)

    def lost(self, leases: Iterable[Lease]) -> None:
        """Nothing is kept of these: their records are too large, or the store has lost them."""
        for lease in leases:
            if self._tell(lease, 0, is_kept=False):
                self._count("lost")

    def gone(self, leases: Iterable[Lease]) -> None:
        """The store has lost these. Sessions that play are saved with their next plan; the others are asked for here.

        Only some at a time, to keep no engine busy for long: the writer reports those that are still missing again.
        """
        leases = list(leases)
        self.lost(leases)
        for lease in leases[:MOST_SAVED_AGAIN]:
            entry = self._entries.get(lease)
            if entry is not None and not entry.closing and entry.closed is None:
                entry.model.engine.submit(SaveAgain(entry.key, 0, self._loop.time()))

    def failed(self) -> None:
        """The store fails: no record can be relied upon."""
        for lease in list(self._entries):
            self._tell(lease, 0, is_kept=False)

    def fenced(self, leases: Iterable[Lease]) -> None:
        """Other servers have taken these over: they end here."""
        for lease in leases:
            self._count("fenced")
            entry = self._let_go(lease)
            if entry is not None and not entry.closing:
                close(entry, CloseReason.TAKEN_OVER, self._loop.time())

    def _tell(self, lease: Lease, taken_seq: int, *, is_kept: bool) -> bool:
        """Tell a client if what is saved of its session has changed. Returns whether it has."""
        entry = self._entries.get(lease)
        if entry is None or entry.closed is not None:
            return False
        before = entry.durable
        now = Durable(entry.key, max(taken_seq, 0 if before is None else before.durable_seq), is_kept)
        if now == before:
            return False
        entry.durable = now
        entry.carrier.take(now)
        return True


def _read(held: Held, epoch: int, tenant: str) -> SessionRecord:
    """Read the record of a tenant's session, for a client with a token of that epoch. Raises NotKept."""
    try:
        record = read_record(held.data)
    except RecordRefused as error:
        raise NotKept(str(error)) from error
    if record.tenant != tenant:  # the client is only told that the session is not kept
        raise NotKept("it is another tenant's session")
    if not record.told_epoch <= epoch <= held.epoch:
        raise NotKept(f"its token is of epoch {epoch}; valid are epochs {record.told_epoch} to {held.epoch}")
    return record


def _record_of(entry: SessionEntry, taken: SnapshotTaken) -> SessionRecord:
    assert entry.opened is not None
    snapshot = taken.snapshot
    taken_seq = snapshot.last_seq
    while entry.is_answered(taken_seq + 1):  # events that the edge refused never reached the engine
        taken_seq += 1
    waiting = {edit.event_seq for edit in snapshot.unanswered}
    return SessionRecord(
        tenant=entry.place.peer.tenant,
        request_id=entry.request_id,
        taken_seq=taken_seq,
        opened=replace(entry.opened, session_token=""),
        level=entry.level,
        answers=entry.answers.up_to(taken_seq),
        reached=tuple(reached for reached, _ in entry.reached),
        warnings={seq: said for seq, said in entry.warnings.items() if seq in waiting},
        attempt=entry.attempt,
        snapshot=snapshot,
        told_epoch=entry.told_epoch,
    )


class _OnLoop:
    """The writer's listener: passes everything on to the event loop."""

    def __init__(self, durability: Durability, loop: asyncio.AbstractEventLoop) -> None:
        self._durability = durability
        self._loop = loop

    def _call(self, act: Callable[..., None], *what: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has been closed: the process is on its way out
            self._loop.call_soon_threadsafe(act, *what)

    def written(self, written: list[Written]) -> None:
        self._call(self._durability.written, written)

    def renewed(self, leases: list[Lease]) -> None:
        self._call(self._durability.renewed, leases)

    def fenced(self, leases: list[Lease]) -> None:
        self._call(self._durability.fenced, leases)

    def lost(self, leases: list[Lease]) -> None:
        self._call(self._durability.lost, leases)

    def gone(self, leases: list[Lease]) -> None:
        self._call(self._durability.gone, leases)

    def failed(self) -> None:
        self._call(self._durability.failed)
