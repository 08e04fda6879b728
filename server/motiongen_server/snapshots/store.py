"""SnapshotStore: the interface of stores for sessions' snapshots, and what each must guarantee.

A session's record has an epoch, its fencing token: a server that takes the session over raises it, and from then on
nothing is written with a lower one. So two servers may both believe for a moment that they hold a session, but never
both write it, and the one that no longer holds it finds out with its next write or renewal.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple, Protocol


class StoreFailed(Exception):
    """A call of the store failed: it is unreachable, slow, full or broken. The message says which."""


class Lease(NamedTuple):
    """The right to write a session's record. name: the record's, not a secret; epoch: its fencing token, from 1."""

    name: str
    epoch: int


class Held(NamedTuple):
    """A record, and its holder's epoch: after a take-over, that of the new holder."""

    epoch: int
    data: bytes


class Renewal(IntEnum):
    """What became of a lease. FENCED: another server holds the session. GONE: the store no longer has its record."""

    FENCED = 0
    KEPT = 1
    GONE = 2


class SnapshotStore(Protocol):
    """Called from threads, never from the event loop. Every call ends within a second or so, or raises StoreFailed."""

    def save(self, records: Sequence[tuple[Lease, bytes]]) -> list[bool]:
        """Replace records. Returns, in their order, False for those that another server holds with a higher epoch."""
        ...

    def read(self, name: str) -> Held | None:
        """The record of a session, whose holder stays the same. None: there is no record."""
        ...

    def take(self, lease: Lease, holder: str) -> Held | None:
        """Take a session over from the holder of that lease: raise its epoch and return its record, as one step.

        None: nobody holds that lease: the session has been taken over already, or there is no record of it.
        """
        ...

    def renew(self, leases: Sequence[Lease]) -> list[Renewal]:
        """Keep records from expiring."""
        ...

    def drop(self, leases: Sequence[Lease]) -> None:
        """Delete the records of sessions that are over, unless another server has taken them."""
        ...

    def close(self) -> None:
        """Close files and connections."""
        ...
