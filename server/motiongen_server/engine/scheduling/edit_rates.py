"""EditRates: how many windows a second edits begin, by the owner of the sessions that they change."""

from __future__ import annotations

from collections.abc import Mapping

from motiongen_server.engine.types import Owner

# What was seen counts half as much after so long.
_HALF_LIFE_S = 4.0
# Less than so many windows a second are forgotten.
_LEAST_HZ = 1e-3


class EditRates:
    """Windows a second that edits of each owner's sessions have begun of late. Time comes in as an argument."""

    def __init__(self) -> None:
        self._begun: dict[str, float] = {}
        self.by_owner: Mapping[str, float] = {}

    def note(self, owner: Owner, share: float) -> None:
        """A window was begun for an edit. share: of a whole window's steps, below 0 for one that was let go of."""
        self._begun[owner.name] = self._begun.get(owner.name, 0.0) + share

    def update(self, elapsed_s: float) -> None:
        """Take in what was begun in the last elapsed_s; `by_owner` is another mapping from then on."""
        kept = 0.5 ** (elapsed_s / _HALF_LIFE_S)
        rates = {}
        for name in self.by_owner.keys() | self._begun.keys():
            seen_hz = self._begun.get(name, 0.0) / elapsed_s
            rate = kept * self.by_owner.get(name, 0.0) + (1.0 - kept) * seen_hz
            if rate > _LEAST_HZ:
                rates[name] = rate
        self._begun.clear()
        self.by_owner = rates
