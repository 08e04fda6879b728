"""Dense paths, with the root's position at (nearly) every frame: how to join one, and how to round its corners."""

from __future__ import annotations

import math

import numpy as np

from motiongen_ardy.model.sampling.options import PlanOptions
from motiongen_ardy.model.sampling.steering import smoothstep

# Above this, bends of a drawn path are rounded; people's own paths stay below it.
SHARPEST_M_S2 = 6.0
ROUNDING_FRAMES = 2.4
FASTEST_M_S = 4.5


def rounded(ground: np.ndarray, fps: int) -> np.ndarray:
    """A path (T, 2) with its sharp corners rounded; elsewhere it is unchanged."""
    if len(ground) < 3:
        return ground
    bend = np.zeros(len(ground))
    bend[1:-1] = np.hypot(*(ground[2:] - 2.0 * ground[1:-1] + ground[:-2]).T) * fps**2
    if bend.max() <= SHARPEST_M_S2:
        return ground
    reach = math.ceil(3 * ROUNDING_FRAMES)
    offsets = np.arange(-reach, reach + 1)
    kernel = np.exp(-0.5 * (offsets / ROUNDING_FRAMES) ** 2)
    kernel /= kernel.sum()
    # Extend the path straight beyond its ends, so that its first and last frames stay where they are.
    longer = np.concatenate([_straight(ground[::-1], reach)[::-1], ground, _straight(ground, reach)])
    smooth = np.stack([np.convolve(longer[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
    near = np.zeros(len(ground))
    for frame in np.flatnonzero(bend > SHARPEST_M_S2):
        distance = np.abs(np.arange(len(ground)) - frame)
        near = np.maximum(near, 1.0 - smoothstep((distance - reach) / (2.0 * reach)))
    return ground + near[:, None] * (smooth - ground)


def _straight(ground: np.ndarray, count: int) -> np.ndarray:
    """`count` points that continue a path (T, 2) straight."""
    return ground[-1] + np.arange(1, count + 1)[:, None] * (ground[-1] - ground[-2])


def limited(ground: np.ndarray, start: np.ndarray, fps: int) -> np.ndarray:
    """A path (T, 2), followed from start (2) no faster than anyone runs; where it is faster, it is cut short."""
    step = FASTEST_M_S / fps
    steps = np.hypot(*np.diff(np.concatenate([start[None], ground]), axis=0).T)
    if len(ground) == 0 or steps[1:].max(initial=0.0) <= step:
        return ground
    held, at = np.empty_like(ground), ground[0]
    for frame, wanted in enumerate(ground):
        away = wanted - at
        at = at + away * min(1.0, step / max(float(np.hypot(*away)), 1e-9))
        held[frame] = at
    return held


def joined(values: np.ndarray, offset: np.ndarray, drift: np.ndarray, most: float, rate: float, fps: int) -> np.ndarray:
    """A signal (T, C), joined smoothly from a state `offset` (C) off it and drifting by `drift` (C) a second.

    The state is that of the frame before the signal. most, rate: greatest acceleration and speed of the correction.
    """
    size, speed = float(np.linalg.norm(offset)), float(np.linalg.norm(drift))
    seconds = max(math.sqrt(6.0 * size / most), 1.5 * size / rate, 4.0 * speed / most, 0.1)
    share = np.minimum(np.arange(1, len(values) + 1) / (seconds * fps), 1.0)[:, None]
    left = 1.0 - smoothstep(share)
    tail = share * (1.0 - share) ** 2 * seconds
    approached: np.ndarray = values + left * offset + tail * drift
    return approached


def bounds(options: PlanOptions) -> tuple[float, float]:
    """Greatest acceleration (m/s^2) and speed (m/s) of a character that returns to its path."""
    return 2.0 * options.acceleration_m_s2, 0.8 * options.speed_m_s
