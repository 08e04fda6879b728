"""RefusedRecords: the sessions of which a record was too big to be kept."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen_server.snapshots.store import Lease


class RefusedRecords:
    """Those whose newest record was refused are in it: what the store has of them is older than their clients know."""

    def __init__(self) -> None:
        self._newest: dict[Lease, bool] = {}  # whether it was

    def __contains__(self, lease: Lease) -> bool:
        return self._newest.get(lease, False)

    def note(self, lease: Lease) -> bool:
        """The newest record was refused. Returns whether it is the first of its session."""
        is_first = lease not in self._newest
        self._newest[lease] = True
        return is_first

    def note_kept(self, leases: Iterable[Lease]) -> None:
        """The newest records of these are in the store."""
        self._newest.update((lease, False) for lease in leases if lease in self._newest)

    def forget(self, lease: Lease) -> None:
        """The session is over, or another's."""
        self._newest.pop(lease, None)
