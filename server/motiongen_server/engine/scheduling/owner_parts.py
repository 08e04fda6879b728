"""OwnerParts: how much of the machine owners' edits take beyond those owners' parts of it.

An owner's part follows from its weight among the owners that have sessions or ask for one. What its sessions take to
play on is its own, however much it is, since they were admitted for that. What its edits take beyond its part gives way
in every step (`owner_shares`), so it is no reason to refuse another owner or to give anybody less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.types import ModelFacts, Owner, SessionSpec


@dataclass(slots=True)
class _Held:
    """One owner's sessions, and the sum of their denoising steps per window. weight: as of its latest session."""

    weight: float
    sessions: int = 0
    steps: int = 0


class OwnerParts:
    """Counts playing sessions by owner. Not thread-safe: the caller holds a lock."""

    def __init__(self, facts: ModelFacts) -> None:
        self._playing_hz = facts.fps / facts.horizon  # windows of a session that is never edited
        self._held: dict[str, _Held] = {}

    def count(self, spec: SessionSpec, change: int) -> None:
        """Count a session in, or out."""
        owner = spec.owner
        held = self._held.setdefault(owner.name, _Held(owner.weight))
        held.weight = owner.weight
        held.sessions += change
        held.steps += change * spec.denoise_steps
        if not held.sessions:
            del self._held[owner.name]

    def yielding(self, prices: Prices, edits_hz: Mapping[str, float], asks: Owner | None = None) -> float:
        """The share of the machine that edits take beyond their owners' parts.

        edits_hz: as of `EditRates`. asks: an owner that wants more: it has a part too, and its own edits are left out.
        """
        total = sum(held.weight for held in self._held.values())
        if asks is not None and asks.name not in self._held:
            total += asks.weight
        beyond = 0.0
        for name, held in self._held.items():
            if asks is None or name != asks.name:
                edited = edits_hz.get(name, 0.0) * prices.whole_s(held.steps / held.sessions)
                played = self._playing_hz * prices.whole_s(held.steps, held.sessions)
                beyond += min(edited, max(0.0, played + edited - held.weight / total))
        return beyond
