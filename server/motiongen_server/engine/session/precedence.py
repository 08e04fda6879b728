"""Precedence: which of the constraints that a window sees hold, where they contradict each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motiongen_server.engine.session.kinematics import Float64
from motiongen_server.engine.types import Constraint, JointTargets, Keyframe, RootTrajectory, Waypoint

FASTEST_M_S = 4.0
"""Nobody is asked to run faster from the place of one constraint to that of another."""
_NEAR_M = 0.05


def in_force(constraints: Sequence[Constraint], window: range, fps: int) -> tuple[Constraint, ...]:
    """The constraints of a window in the order in which they are laid on one another: the lighter first, then as set.

    One whose place nobody could come to from that of a heavier one, or go to it from there, is left out.
    """
    if len({item.weight for item in constraints}) < 2:
        return tuple(constraints)
    kept: list[Constraint] = []
    heavier: list[tuple[float, Float64]] = []
    for index in sorted(range(len(constraints)), key=lambda index: (constraints[index].weight, index), reverse=True):
        item = constraints[index]
        places = _places(item, window)
        if any(weight > item.weight and _is_too_far(places, other, fps) for weight, other in heavier):
            continue
        kept.append(item)
        heavier.append((item.weight, places))
    return tuple(reversed(kept))


def _places(item: Constraint, window: range) -> Float64:
    """(K, 3) frames and ground places that it asks of the root, of a trajectory those in the window; none, for none."""
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


def _is_too_far(places: Float64, others: Float64, fps: int) -> bool:
    """Whether a person would have to be faster than FASTEST_M_S anywhere. At one frame the weight says which holds."""
    if not len(places) or not len(others):
        return False
    frames = np.abs(places[:, None, 0] - others[None, :, 0])
    apart = np.hypot(*np.moveaxis(places[:, None, 1:] - others[None, :, 1:], -1, 0))
    return bool(np.any((frames > 0) & (apart > FASTEST_M_S * frames / fps + _NEAR_M)))
