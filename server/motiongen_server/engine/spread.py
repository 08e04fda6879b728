"""Numbers spread evenly over an interval, however many there are."""

from __future__ import annotations

_GOLDEN_RATIO = 0.618033988749895


def spread(number: int) -> float:
    """0 .. 1 for 0, 1, 2, ...: each far from the ones before it (the golden ratio's multiples)."""
    return number * _GOLDEN_RATIO % 1.0


def spread_delay_s(least_s: float, number: int) -> float:
    """When the one of a number is to come back, at least_s to twice that.

    Those who are sent away together should not come back together.
    """
    return round(least_s * (1.0 + spread(number)), 2)
