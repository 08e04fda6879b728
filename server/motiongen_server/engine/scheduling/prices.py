"""Prices: what windows take of the machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Prices:
    """Seconds of the machine when its steps are full: of one step of a window, and of the window besides its steps."""

    step_s: float = 0.0
    window_s: float = 0.0

    def whole_s(self, steps: float, windows: int = 1) -> float:
        """Of so many windows, which have so many steps together. Steps of a mean window need not be whole."""
        return steps * self.step_s + windows * self.window_s
