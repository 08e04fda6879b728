"""Precedence: which of a window's constraints hold if they contradict each other."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from motiongen_server.engine.session.kinematics import Float64
from motiongen_server.engine.types import Constraint, JointTargets, Keyframe, RootTrajectory, Waypoint

FASTEST_M_S = 4.0
"""No character is asked to run faster than this from the place of one constraint to that of another."""
_NEAR_M = 0.05
_ANGLES = np.arange(32) * (2 * np.pi / 32)
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


def in_force(constraints: Sequence[Constraint], window: range, fps: int) -> tuple[Constraint, ...]:
    """The constraints of a window in the order in which they are applied over one another: lighter first, then as set.

    A constraint is left out if nobody could get from a heavier one's place to its own, or back, in time. The effort is
    proportional to the number of constraints: a client may send hundreds, each with its own weight, and every window
    asks again.
    """
    if len({item.weight for item in constraints}) < 2:
        return tuple(constraints)
    places = [_places(item, window) for item in constraints]
    heavier = _HeavierPlaces(np.unique(np.concatenate([each[:, 0] for each in places])), FASTEST_M_S / fps)
    order = sorted(range(len(constraints)), key=lambda index: (constraints[index].weight, index), reverse=True)
    kept: list[int] = []
    for _, equal in groupby(order, key=lambda index: constraints[index].weight):
        of_weight = [index for index in equal if not heavier.are_too_far_from(places[index])]
        for index in of_weight:
            heavier.add(places[index])
        kept += of_weight
    return tuple(constraints[index] for index in reversed(kept))


class _HeavierPlaces:
    """Ground places at frames, and whether a person who is at another place in some frame can be at all of them.

    The farthest place is searched for in _DIRECTIONS only, so a distance counts as up to half a percent too short.
    """

    def __init__(self, frames: Float64, step_m: float) -> None:
        """frames: (F) all that will be asked for, rising. step_m: how far a person gets from one frame to the next."""
        self._frames = frames
        self._run_m = ((frames - frames[0]) * step_m)[:, None] if len(frames) else np.empty((0, 1))
        self._farthest = np.full((len(frames), len(_DIRECTIONS)), -np.inf)  # (F, D) of the places at each frame
        self._needed: Float64 | None = None

    def add(self, places: Float64) -> None:
        """places: (K, 3) frame, x, z, each frame once."""
        at = np.searchsorted(self._frames, places[:, 0])
        self._farthest[at] = np.maximum(self._farthest[at], places[:, 1:] @ _DIRECTIONS.T)
        self._needed = None

    def are_too_far_from(self, places: Float64) -> bool:
        """Whether a person would have to be too fast anywhere. Within one frame the weight alone decides."""
        if not len(places):
            return False
        if self._needed is None:
            self._needed = self._least_along()
        at = np.searchsorted(self._frames, places[:, 0])
        return bool((self._needed[at] - places[:, 1:] @ _DIRECTIONS.T > _NEAR_M).any())

    def _least_along(self) -> Float64:
        """(F, D): how far along each direction one must be at a frame to get from and to the places at other frames."""
        needed = np.full_like(self._farthest, -np.inf)
        before = np.maximum.accumulate(self._farthest + self._run_m)
        after = np.maximum.accumulate((self._farthest - self._run_m)[::-1])[::-1]
        needed[1:] = before[:-1] - self._run_m[1:]
        needed[:-1] = np.maximum(needed[:-1], after[1:] + self._run_m[:-1])
        return needed


def _places(item: Constraint, window: range) -> Float64:
    """(K, 3): frames and ground places asked of the root, those of a trajectory within the window; may be empty."""
    match item:
        case Waypoint():
            return np.array([[item.frame, item.x, item.z]], np.float64)
        case RootTrajectory():
            first, end = max(item.first_frame, window.start), min(item.last_frame + 1, window.stop)
            frames = np.arange(first, end, dtype=np.float64)
            return np.column_stack([frames, item.xz[first - item.first_frame : max(first, end) - item.first_frame]])
        case Keyframe():
            return np.array([[item.frame, *item.positions[0, [0, 2]]]], np.float64)
        case JointTargets() if 0 in item.joints:
            root = item.positions[item.joints.index(0)]
            return np.array([[item.frame, root[0], root[2]]], np.float64)
    return np.empty((0, 3))
