"""Correction curves over a window: each meets one goal and leaves the other goals unchanged."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

_CURVES_KEPT = 64  # each is 13 kB for a window of 40 frames, and takes 0.1 ms to compute


@lru_cache(maxsize=_CURVES_KEPT)
def goal_curves(goals: tuple[int, ...], num_frames: int) -> np.ndarray:
    """(T, T): column g is the correction over all frames that is 1 at goal g and 0 at the others; other columns are 0.

    A C2 cubic spline through the goals: zero and flat at the frame before the first, flat at the last goal, and
    constant after it.
    """
    curves = np.zeros((num_frames, num_frames))
    if not goals:
        return curves
    knots = np.array([0.0, *(goal + 1.0 for goal in goals)])
    values = np.eye(len(knots))[:, 1:]
    slopes = _spline_slopes(knots, values)
    time = np.minimum(np.arange(1.0, num_frames + 1.0), knots[-1])
    left = np.clip(np.searchsorted(knots, time, side="left") - 1, 0, len(knots) - 2)
    span = (knots[left + 1] - knots[left])[:, None]
    share = (time[:, None] - knots[left][:, None]) / span
    rise = share * share * (3.0 - 2.0 * share)
    curve = values[left] * (1.0 - rise) + values[left + 1] * rise
    curve += span * share * (1.0 - share) * (slopes[left] * (1.0 - share) - slopes[left + 1] * share)
    curves[:, list(goals)] = curve
    curves.setflags(write=False)
    return curves


def _spline_slopes(knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Slopes (K, C) of a cubic spline through values (K, C) that is flat at both ends."""
    count, gaps = len(knots), np.diff(knots)
    system, right = np.eye(count), np.zeros_like(values)
    rises = np.diff(values, axis=0) / gaps[:, None]
    for inner in range(1, count - 1):
        before, after = gaps[inner - 1], gaps[inner]
        system[inner, inner - 1 : inner + 2] = after, 2.0 * (before + after), before
        right[inner] = 3.0 * (after * rises[inner - 1] + before * rises[inner])
    slopes: np.ndarray = np.linalg.solve(system, right)
    return slopes
