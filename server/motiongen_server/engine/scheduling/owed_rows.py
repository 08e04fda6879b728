"""OwedRows: what parties are owed of the rows of denoising steps, by their shares (deficit round robin)."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from typing import Generic, TypeVar

Party = TypeVar("Party", bound=Hashable)

# Nobody is ever owed more than its share of a step and so many rows of the steps before: what it did not ask for in
# time is not kept. They are what whole rows leave of shares: a part of one in each step, and where several are owed a
# whole one at once, more than a step has.
_MOST_KEPT = 2.0


class OwedRows(Generic[Party]):
    """Counts while a party waits for rows; who does not wait is owed nothing."""

    def __init__(self) -> None:
        self._owed: dict[Party, float] = {}

    def whole(self) -> list[tuple[Party, int]]:
        """Who is owed whole rows, and how many: the most owed first."""
        owed = sorted(self._owed.items(), key=lambda entry: -entry[1])
        return [(party, int(rows)) for party, rows in owed if rows >= 1.0]

    def forget(self) -> None:
        """Nobody is owed anything."""
        self._owed.clear()

    def settle(
        self, rows: int, shares: Mapping[Party, float], taken: Mapping[Party, int], waiting: Collection[Party]
    ) -> None:
        """A step of so many rows was given out. shares: of 1, for all who wait; taken: rows that parties got."""
        owed: dict[Party, float] = {}
        for party in waiting:
            share = shares[party] * rows
            left = self._owed.get(party, 0.0) + share - taken.get(party, 0)
            if left > 0.0:
                owed[party] = min(left, share + _MOST_KEPT)
        self._owed = owed
