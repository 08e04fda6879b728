"""OwnerParts: what edits of owners take of the machine beyond those owners' parts of it.

An owner's part goes by its weight among those who have sessions or ask for one. What its sessions take to play on is
its own, however much that is: they were let in for it. What its edits take beyond the part gives way, in every step
(`owner_shares`), so it is no reason to send another owner away, or to give anybody less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.types import ModelFacts, Owner, SessionSpec


@dataclass(slots=True)
class _Held:
    """Of one owner: its sessions, and their denoising steps a window together. weight: as its latest session has it."""

    weight: float
    sessions: int = 0
    steps: int = 0


class OwnerParts:
    """Counts sessions that are played by owner. Not thread-safe: its owner holds a lock."""

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
        """The share of the machine that edits take beyond the parts of their owners; of the owner that asks, none.

        edits_hz: as of `EditRates`. asks: who wants more, and has a part too; None: nobody.
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
