"""Paths over the ground: lines with rounded corners, walked at a speed, and how long that takes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motiongen_ardy.locomotion.velocity import RootState

Float64 = NDArray[np.float64]

WALK_M_S = 1.2
"""The speed of a walk whose speed is not specified, unless the character is already moving faster."""
# Typical of people, and below what they are capable of, so that a body can follow.
ACCELERATION_M_S2 = 1.5
_SIDEWAYS_M_S2 = 2.0
_TURN_RAD_S = 2.0
_SHORTEST_S = 0.6
_STEP_M = 0.5
_SAMPLE_M = 0.05
_MOST_SAMPLES = 1500
_SAME_M = 1e-4


def walking_s(root: RootState, place: tuple[float, float], heading: float | None) -> float:
    """Seconds that a person needs to reach a place (x, z, metres) and face as asked. heading: radians; None: any.

    If the place is more than a step away, the person first turns toward it, and at the end to the heading.
    """
    away_x, away_z = place[0] - root.x, place[1] - root.z
    distance = math.hypot(away_x, away_z)
    facing, turns = root.heading, 0.0
    if distance > _STEP_M:
        way = math.atan2(away_x, away_z)
        turns, facing = abs(math.remainder(way - facing, math.tau)), way
    if heading is not None:
        turns += abs(math.remainder(heading - facing, math.tau))
    towards = (root.speed_x * away_x + root.speed_z * away_z) / max(distance, 1e-6)
    speed = max(WALK_M_S, towards)
    changes = abs(speed - towards) + speed
    moving = distance / speed + 0.5 * changes / ACCELERATION_M_S2 if distance > _STEP_M else 2.0 * distance / WALK_M_S
    return max(_SHORTEST_S, moving + turns / _TURN_RAD_S)


class WayTooLong(ValueError):
    """A path takes longer than allowed. seconds: how long it takes."""

    def __init__(self, seconds: float) -> None:
        super().__init__(f"the way takes {seconds:.0f} s")
        self.seconds = seconds


def walked(
    corners: NDArray[Any], speed: float, smoothing_m: float, root: RootState, fps: int, most_s: float = math.inf
) -> Float64:
    """Ground positions (T, 2), one per frame after `root`, along lines from there through corners (N, 2), to a stand.

    speed: metres a second on straight parts; bends are slower. The path deviates from its lines by at most smoothing_m.
    Raises WayTooLong if it takes longer than most_s, before any position is computed.
    """
    places = np.concatenate([[[root.x, root.z]], np.asarray(corners, np.float64)])
    keep = np.concatenate([[True], np.hypot(*np.diff(places, axis=0).T) > _SAME_M])
    places = places[keep]
    if len(places) == 1:
        return places
    way = _sampled(rounded(places, smoothing_m))
    steps = np.hypot(*np.diff(way, axis=0).T)
    first = way[1] - way[0]
    turn = abs(math.remainder(math.atan2(first[0], first[1]) - root.heading, math.tau))
    along = (root.speed_x * first[0] + root.speed_z * first[1]) / steps[0]
    pace = _paces(way, steps, speed, max(0.0, min(along, speed)))
    wait = turn / _TURN_RAD_S if turn > math.pi / 4 else 0.0
    takes_s = 2.0 * steps / np.maximum(pace[:-1] + pace[1:], 1e-6)
    at_s = np.concatenate([[0.0], np.cumsum(takes_s)]) + wait
    if at_s[-1] > most_s:
        raise WayTooLong(float(at_s[-1]))
    frames = np.arange(1, math.ceil(at_s[-1] * fps) + 1) / fps
    step = np.clip(np.searchsorted(at_s, frames, side="right") - 1, 0, len(steps) - 1)
    # Constant acceleration within each step.
    since = np.clip(frames - at_s[step], 0.0, takes_s[step])
    gone = since * (pace[step] + 0.5 * since * (pace[step + 1] - pace[step]) / takes_s[step])
    share = np.clip(gone / steps[step], 0.0, 1.0)[:, None]
    return np.asarray((1.0 - share) * way[step] + share * way[step + 1])


def rounded(places: Float64, within_m: float) -> Float64:
    """A line (N, 2) with its corners cut by parabolas that stay within within_m of it; its end points are kept.

    A parabola from d before the corner to d after it passes the corner at a distance of d cos(angle / 2) / 2, where
    angle is that between the legs, and no point of it is farther from them.
    """
    if within_m <= 0 or len(places) < 3:
        return places
    share = np.linspace(0.0, 1.0, 17)[:, None]
    corner = places[1:-1]
    back, on = places[:-2] - corner, places[2:] - corner
    back_m, on_m = np.hypot(*back.T), np.hypot(*on.T)
    back, on = back / back_m[:, None], on / on_m[:, None]
    half = np.hypot(*(back + on).T) / 2.0  # cos of half the angle between the legs
    reach = np.minimum(2.0 * within_m / np.maximum(half, 1e-6), np.minimum(back_m, on_m) / 2.0)[:, None]
    begin, end = (corner + reach * back)[:, None], (corner + reach * on)[:, None]
    bends = (1 - share) ** 2 * begin + 2 * share * (1 - share) * corner[:, None] + share**2 * end
    return np.concatenate([places[:1], bends.reshape(-1, 2), places[-1:]])


def _sampled(line: Float64) -> Float64:
    """The same line resampled in even, short steps; its last point is kept."""
    steps = np.hypot(*np.diff(line, axis=0).T)
    line, steps = line[np.concatenate([[True], steps > 0])], steps[steps > 0]
    at = np.concatenate([[0.0], np.cumsum(steps)])
    # At least one sample in the middle: a path that starts and ends at speed zero would otherwise never begin.
    count = min(max(3, math.ceil(at[-1] / _SAMPLE_M) + 1), _MOST_SAMPLES)
    places = np.linspace(0.0, at[-1], count)
    return np.stack([np.interp(places, at, line[:, axis]) for axis in (0, 1)], axis=1)


def _paces(way: Float64, steps: Float64, speed: float, first: float) -> Float64:
    """Metres a second at the samples of a path (T, 2): from `first` to a stand, limited by bends and acceleration."""
    most = np.full(len(way), speed)
    if len(way) > 2:
        heading = np.unwrap(np.arctan2(*np.diff(way, axis=0).T))
        # Over the length of a step: from one sample to the next, a drawn line is all corners.
        apart = max(1, round(0.3 / float(steps[0])))
        bend = np.abs(heading[apart:] - heading[:-apart]) / (apart * float(steps[0])) if len(heading) > apart else []
        slow = np.sqrt(_SIDEWAYS_M_S2 / np.maximum(bend, 1e-6))
        begin = 1 + apart // 2
        most[begin : begin + len(slow)] = np.minimum(speed, slow)
    return paced(most, steps, first)


def paced(most: Float64, steps: Float64, first: float) -> Float64:
    """Metres a second at samples (T): from `first` to a stand, limited by `most` (T) and by ACCELERATION_M_S2.

    steps: (T - 1), metres from each sample to the next. The square of the speed changes by at most 2 * acceleration *
    step, so both limits are running minima.
    """
    gained = np.concatenate([[0.0], np.cumsum(2.0 * ACCELERATION_M_S2 * steps)])
    squares = most**2
    squares[0], squares[-1] = first**2, 0.0
    squares = np.minimum.accumulate(squares - gained) + gained
    squares = np.minimum.accumulate((squares + gained)[::-1])[::-1] - gained
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))
