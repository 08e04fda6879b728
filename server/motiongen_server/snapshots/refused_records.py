"""RefusedRecords: the sessions that have had a record too large to be kept."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen_server.snapshots.store import Lease


class RefusedRecords:
    """Contains sessions whose newest record was refused: the store has older records than their clients were told."""

    def __init__(self) -> None:
        self._newest: dict[Lease, bool] = {}  # whether the newest record was refused

    def __contains__(self, lease: Lease) -> bool:
        return self._newest.get(lease, False)

    def note(self, lease: Lease) -> bool:
        """A session's newest record was refused. Returns whether that is the session's first refusal."""
        is_first = lease not in self._newest
        self._newest[lease] = True
        return is_first

    def note_kept(self, leases: Iterable[Lease]) -> None:
        """The newest records of these sessions are in the store."""
        self._newest.update((lease, False) for lease in leases if lease in self._newest)

    def forget(self, lease: Lease) -> None:
        """The session is over, or another server has it."""
        self._newest.pop(lease, None)
