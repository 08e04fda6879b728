"""Durability: the edge's side of snapshots: what is saved of a session, what its client is told, and taking over.

A session's token is a secret and the fencing epoch that it was told with: `secret.epoch`. The record's name is a hash
of the secret, so that the store gives nobody a session. Whoever takes a session over tells its client a new token; the
one who held it before does not know that one, and so never goes on with a session that has moved on elsewhere.

That answer may be lost, more than once, and the client comes again with the token that it has. So a token is good until
the client was seen to have a newer one: it came with that, or has said something to who told it. One of a higher epoch
than the record's was told nobody.
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
"""Sessions that are asked for at a time where the store has lost them: tenths of a millisecond each, here and in an
engine, every `writer.RENEW_EVERY_S`."""


class NotKept(Exception):
    """The store has nothing that can be gone on with; the message says why, for the log."""


def new_secret() -> str:
    """Of a session; it names the session to whoever has it."""
    return secrets.token_urlsafe(SECRET_BYTES)


def token_of(secret: str, epoch: int = 1) -> str:
    """What a client resumes the session with."""
    return f"{secret}.{epoch}"


def lease_of(token: str) -> Lease:
    """The record that a token stands for, and the epoch that it was told with. Raises NotKept for no token of ours."""
    secret, _, epoch = token.rpartition(".")
    if not secret or not epoch.isascii() or not epoch.isdecimal() or len(epoch) > 12:
        raise NotKept("that is no token of a session")
    return Lease(hashlib.sha256(secret.encode()).hexdigest(), int(epoch))


class Durability:
    """Used from the event loop; the writer's thread speaks to it through the loop."""

    def __init__(self, store: SnapshotStore, loop: asyncio.AbstractEventLoop, count: Callable[[str], None]) -> None:
        """count: is told of every snapshot that was written, fenced or lost."""
        self._loop = loop
        self._count = count
        self._entries: dict[Lease, SessionEntry] = {}
        self._by_name: dict[str, SessionEntry] = {}  # the newest of each record
        self._taker = SnapshotTaker(store)
        self._turns = StoreTurns(loop.time)
        self.writer = SnapshotWriter(store, _OnLoop(self, loop))

    def save(self, entry: SessionEntry, taken: SnapshotTaken) -> None:
        """Keep a session as its engine and the edge know it now."""
        if entry.opened is None or not entry.token or entry.closing:
            return
        lease = self._hold(entry) if entry.lease is None else entry.lease
        self.writer.save(lease, _record_of(entry, taken))

    def end(self, entry: SessionEntry) -> None:
        """A session is over here. What may go on elsewhere stays: this server goes away, or has lost its engine."""
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
        """The token from now on and the record of a session that another server held.

        check: raises what else there is against it. Where anything is, the session stays with the server that has it.
        Raises NotKept, and EventRefused where the store is busy or does not answer: whether it is kept is not known.
        """
        name, epoch = lease_of(token)

        def read(found: Held) -> SessionRecord:
            record = _read(found, epoch, tenant)
            check(record)
            return record

        async def ask() -> tuple[str, SessionRecord]:
            held = None
            while held is None:  # else another has taken it since, as this client may have, whose answer was lost
                found = await asyncio.wrap_future(self._taker.read(name))
                if found is None:
                    raise NotKept("the store has no such session")
                read(found)
                held = await asyncio.wrap_future(self._taker.take(Lease(name, found.epoch)))
                self._turns.note_answer()  # not before: a store that is full can be read, and lets nobody take
            return token_of(token.rpartition(".")[0], held.epoch), read(held)

        try:
            return await self._turns.take(asker, ask)
        except StoreAway as error:
            raise NotKept(str(error)) from error

    def adopt(self, entry: SessionEntry) -> None:
        """A session that was taken over is this server's now, and saved: else what its client has said since would be
        refused where it goes on elsewhere before it is saved again."""
        self.writer.hold(self._hold(entry))
        entry.durable = Durable(entry.key, entry.last_seq, not self.writer.is_failing)

    def held(self, token: str) -> SessionEntry | None:
        """The session that lives here since it was taken over by that token, or by one as old.

        Its client, which has said nothing of it since, may not have heard: then it comes with what it has.
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
        """A session's record is this server's to write."""
        entry.lease = lease = lease_of(entry.token)
        self._entries[lease] = self._by_name[lease.name] = entry
        return lease

    def _let_go(self, lease: Lease) -> SessionEntry | None:
        """It is not any more. Whose it was, None where it was nobody's."""
        entry = self._entries.pop(lease, None)
        if entry is not None and self._by_name.get(lease.name) is entry:
            del self._by_name[lease.name]
        return entry

    def close(self) -> None:
        """Write what waits, and end. Waits for it a moment."""
        self._taker.close()
        self.writer.close()

    # ---- what the writer says ---------------------------------------------------------------------------------------

    def written(self, written: Iterable[Written]) -> None:
        """These are in the store."""
        for lease, taken_seq in written:
            self._count("written")
            self._tell(lease, taken_seq, is_kept=True)

    def renewed(self, leases: Iterable[Lease]) -> None:
        """These are in the store still."""
        for lease in leases:
            self._tell(lease, 0, is_kept=True)

    def lost(self, leases: Iterable[Lease]) -> None:
        """These are not."""
        for lease in leases:
            if self._tell(lease, 0, is_kept=False):
                self._count("lost")

    def gone(self, leases: Iterable[Lease]) -> None:
        """These are not any more: who plays on is saved with the next plan, and who stands is asked for here.

        A part of them at a time, which keeps no engine long: the writer says it again of those that are still missing.
        """
        leases = list(leases)
        self.lost(leases)
        for lease in leases[:MOST_SAVED_AGAIN]:
            entry = self._entries.get(lease)
            if entry is not None and not entry.closing and entry.closed is None:
                entry.model.engine.submit(SaveAgain(entry.key, 0, self._loop.time()))

    def failed(self) -> None:
        """None is to be relied upon."""
        for lease in list(self._entries):
            self._tell(lease, 0, is_kept=False)

    def fenced(self, leases: Iterable[Lease]) -> None:
        """Other servers go on with these: they end here."""
        for lease in leases:
            self._count("fenced")
            entry = self._let_go(lease)
            if entry is not None and not entry.closing:
                close(entry, CloseReason.TAKEN_OVER, self._loop.time())

    def _tell(self, lease: Lease, taken_seq: int, *, is_kept: bool) -> bool:
        """Tell a client what is new of what is kept. False: nothing is."""
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
    """The record of a tenant's session, for who has the token of that epoch. Raises NotKept."""
    try:
        record = read_record(held.data)
    except RecordRefused as error:
        raise NotKept(str(error)) from error
    if record.tenant != tenant:  # one tenant never learns of another's
        raise NotKept("it is another tenant's session")
    if not record.told_epoch <= epoch <= held.epoch:
        raise NotKept(f"its token is of epoch {epoch}, and good are {record.told_epoch} to {held.epoch}")
    return record


def _record_of(entry: SessionEntry, taken: SnapshotTaken) -> SessionRecord:
    assert entry.opened is not None
    snapshot = taken.snapshot
    taken_seq = snapshot.last_seq
    while entry.is_answered(taken_seq + 1):  # what the edge has refused never came to the engine
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
    """The writer's listener: hands everything to the event loop."""

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
