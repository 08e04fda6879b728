"""Spreads any number of values evenly over an interval."""

from __future__ import annotations

_GOLDEN_RATIO = 0.618033988749895


def spread(number: int) -> float:
    """0 .. 1 for 0, 1, 2, ...: each value is far from those before it (multiples of the golden ratio)."""
    return number * _GOLDEN_RATIO % 1.0


def spread_delay_s(least_s: float, number: int) -> float:
    """How long the client with this number should wait before it comes back: from least_s to twice that.

    Clients that are sent away together should not come back together.
    """
    return round(least_s * (1.0 + spread(number)), 2)
