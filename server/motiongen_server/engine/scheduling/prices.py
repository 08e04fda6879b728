"""Prices: what windows cost in time of the machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Prices:
    """Seconds of the machine when its steps are full: per step of a window, and per window besides its steps."""

    step_s: float = 0.0
    window_s: float = 0.0

    def whole_s(self, steps: float, windows: int = 1) -> float:
        """Seconds of this many windows with this many steps in total. Steps may be a mean, so not whole."""
        return steps * self.step_s + windows * self.window_s
