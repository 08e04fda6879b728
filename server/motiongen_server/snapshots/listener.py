"""Listener: who is told what became of the records of sessions."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from motiongen_server.snapshots.store import Lease


class Written(NamedTuple):
    """A record is in the store: the session's events up to taken_seq outlive this process."""

    lease: Lease
    taken_seq: int


class Listener(Protocol):
    """Who is told. Called on the writer's thread, `failed` on any; must return at once and never raise."""

    def written(self, written: list[Written]) -> None:
        """These records are in the store."""

    def renewed(self, leases: list[Lease]) -> None:
        """The records of these are still in the store, and it does again what it had failed to do."""

    def fenced(self, leases: list[Lease]) -> None:
        """Others have taken these sessions over; nothing is saved of them here any more."""

    def lost(self, leases: list[Lease]) -> None:
        """Nothing is kept of these: they are too big."""

    def gone(self, leases: list[Lease]) -> None:
        """The store has lost these, as one does that was started anew: what is kept of them has to come again."""

    def failed(self) -> None:
        """The store does nothing at present, or too slowly to be relied upon."""
