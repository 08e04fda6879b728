"""OwedRows: how many rows of denoising steps parties are owed by their shares (deficit round robin)."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from typing import Generic, TypeVar

Party = TypeVar("Party", bound=Hashable)

# A party is never owed more than its share of a step plus this many rows of earlier steps: rows that it did not ask for
# in time are lost. Those rows are remainders, since rows are whole: a fraction in each step, and more when several
# parties are owed whole rows at once and the step has too few.
_MOST_KEPT = 2.0


class OwedRows(Generic[Party]):
    """Accumulates for a party while it waits for rows; a party that does not wait is owed nothing."""

    def __init__(self) -> None:
        self._owed: dict[Party, float] = {}

    def whole(self) -> list[tuple[Party, int]]:
        """The parties that are owed whole rows, and how many: the most owed first."""
        owed = sorted(self._owed.items(), key=lambda entry: -entry[1])
        return [(party, int(rows)) for party, rows in owed if rows >= 1.0]

    def forget(self) -> None:
        """Forget all that is owed."""
        self._owed.clear()

    def settle(
        self, rows: int, shares: Mapping[Party, float], taken: Mapping[Party, int], waiting: Collection[Party]
    ) -> None:
        """Account for a step. rows: its size; shares: of 1, of all waiting parties; taken: rows that parties got."""
        owed: dict[Party, float] = {}
        for party in waiting:
            share = shares[party] * rows
            left = self._owed.get(party, 0.0) + share - taken.get(party, 0)
            if left > 0.0:
                owed[party] = min(left, share + _MOST_KEPT)
        self._owed = owed
