"""SnapshotStore: where snapshots are kept, and who may write them. What every store of them promises.

A session's record has an epoch, its fencing token: whoever takes the session over raises it, and from then on nothing
is written with a lower one. So two servers may for a moment both believe that they hold a session, but never both write
it, and the one that holds it no longer finds out with its next write or renewal.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple, Protocol


class StoreFailed(Exception):
    """The store did not do what it was asked: it is away, slow, full or broken. The message says which."""


class Lease(NamedTuple):
    """The right to write a session's record. name: of the record, not a secret; epoch: its fencing token, from 1."""

    name: str
    epoch: int


class Held(NamedTuple):
    """A record, and the epoch of who holds it: where it was taken over, of the one who did, from now on."""

    epoch: int
    data: bytes


class Renewal(IntEnum):
    """What became of a lease. FENCED: another holds the session now. GONE: the store has no record of it any more."""

    FENCED = 0
    KEPT = 1
    GONE = 2


class SnapshotStore(Protocol):
    """Called from threads, never from the event loop. Every call ends within a second or so, or raises StoreFailed."""

    def save(self, records: Sequence[tuple[Lease, bytes]]) -> list[bool]:
        """Put records in place of those before them. False, in the same order: fenced, another holds a higher epoch."""
        ...

    def read(self, name: str) -> Held | None:
        """The record of a session, which stays with whoever holds it. None: there is no record."""
        ...

    def take(self, lease: Lease, holder: str) -> Held | None:
        """Take a session over from who holds that lease: raise its epoch and return its record, as one step.

        None: nobody holds it. The session has been taken over already, or there is no record of it.
        """
        ...

    def renew(self, leases: Sequence[Lease]) -> list[Renewal]:
        """Keep records from expiring."""
        ...

    def drop(self, leases: Sequence[Lease]) -> None:
        """Forget the records of sessions that are over, unless another has taken them."""
        ...

    def close(self) -> None:
        """Let go of files and connections."""
        ...
