"""Listener: is told what became of sessions' records."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from motiongen_server.snapshots.store import Lease


class Written(NamedTuple):
    """A record is in the store: the session's events up to taken_seq outlive this process."""

    lease: Lease
    taken_seq: int


class Listener(Protocol):
    """Called on the writer's thread, `failed` on any thread; must return at once and never raise."""

    def written(self, written: list[Written]) -> None:
        """These records were written to the store."""

    def renewed(self, leases: list[Lease]) -> None:
        """After a failure the store works again, and still has the records of these sessions."""

    def fenced(self, leases: list[Lease]) -> None:
        """Other servers have taken these sessions over; they are no longer saved here."""

    def lost(self, leases: list[Lease]) -> None:
        """Nothing is kept of these sessions: their records are too large."""

    def gone(self, leases: list[Lease]) -> None:
        """The store has lost these records, for example because it was restarted empty: they must be saved again."""

    def failed(self) -> None:
        """The store does not work at present, or is too slow to be relied upon."""
