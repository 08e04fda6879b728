"""EditRates: how many windows per second edits begin, by the owner of the edited sessions."""

from __future__ import annotations

from collections.abc import Mapping

from motiongen_server.engine.types import Owner

# What was seen counts half as much after this time.
_HALF_LIFE_S = 4.0
# Rates below this are forgotten.
_LEAST_HZ = 1e-3


class EditRates:
    """Windows per second that edits of each owner's sessions have begun lately. Time is passed as an argument."""

    def __init__(self) -> None:
        self._begun: dict[str, float] = {}
        self.by_owner: Mapping[str, float] = {}

    def note(self, owner: Owner, share: float) -> None:
        """A window was begun for an edit. share: of a full window's steps; negative for a window that was discarded."""
        self._begun[owner.name] = self._begun.get(owner.name, 0.0) + share

    def update(self, elapsed_s: float) -> None:
        """Include what was begun in the last elapsed_s; `by_owner` becomes a new mapping."""
        kept = 0.5 ** (elapsed_s / _HALF_LIFE_S)
        rates = {}
        for name in self.by_owner.keys() | self._begun.keys():
            seen_hz = self._begun.get(name, 0.0) / elapsed_s
            rate = kept * self.by_owner.get(name, 0.0) + (1.0 - kept) * seen_hz
            if rate > _LEAST_HZ:
                rates[name] = rate
        self._begun.clear()
        self.by_owner = rates
