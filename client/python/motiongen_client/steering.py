"""Steering: turns a player's stick or drawn line into velocities and corners in world axes. Pure.

x_mps, z_mps = stick_velocity(right, forward, camera_heading_rad=camera)
walker.set_velocity(x_mps, z_mps, seconds=0.5)           # ten times a second while the stick is held
walker.follow_path(drawn_corners(points_on_the_ground))  # a line that was drawn; a click is `walker.go_to`
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from motiongen_client.errors import InvalidInput
from motiongen_client.motion import Float32
from motiongen_client.types import as_array, check_finite, check_number

MOST_CORNERS = 256
"""Limit on the corners of one `RootPath`."""


def stick_velocity(
    right: float,
    forward: float,
    *,
    camera_heading_rad: float = 0.0,
    speed_mps: float = 3.0,
    dead_zone: float = 0.15,
) -> tuple[float, float]:
    """World x and z in metres per second, for `Session.set_velocity`, from a stick relative to the camera.

    right, forward: -1 to 1; a diagonal is no faster than an axis. camera_heading_rad: the direction in which the camera
    looks over the ground, 0 toward +Z. speed_mps: that of a fully pushed stick. dead_zone: a stick pushed no further
    counts as released; beyond it the speed rises from 0, so that the character eases into a walk. Raises InvalidInput.
    """
    for name, value in (("right", right), ("forward", forward), ("camera_heading_rad", camera_heading_rad)):
        check_finite(name, value)
    check_finite("speed_mps", speed_mps)
    check_number("dead_zone", dead_zone, "0 or more, below 1", lambda share: 0 <= share < 1)
    push = math.hypot(right, forward)
    if push <= dead_zone:
        return 0.0, 0.0
    speed = speed_mps * (min(push, 1.0) - dead_zone) / (1.0 - dead_zone)
    ahead, aside = speed * forward / push, speed * right / push
    sin, cos = math.sin(camera_heading_rad), math.cos(camera_heading_rad)
    # Looking along +Z, +X is to the left.
    return ahead * sin - aside * cos, ahead * cos + aside * sin


def camera_relative(right_m: float, forward_m: float, camera_heading_rad: float) -> tuple[float, float]:
    """World x and z of an offset relative to the camera: to its right, and ahead of it, both in metres.

    Raises InvalidInput.
    """
    for name, value in (("right_m", right_m), ("forward_m", forward_m), ("camera_heading_rad", camera_heading_rad)):
        check_finite(name, value)
    sin, cos = math.sin(camera_heading_rad), math.cos(camera_heading_rad)
    return forward_m * sin - right_m * cos, forward_m * cos + right_m * sin


def drawn_corners(points_m: ArrayLike, *, within_m: float = 0.1) -> Float32:
    """Corners (K, 2), K at most 256, that simplify a line drawn through points_m (N, 2), world x, z in metres.

    No point is farther than within_m from the line through the corners (Ramer 1972, Douglas and Peucker 1973). If that
    takes more corners than a path may have, within_m is doubled until it does not.
    """
    points = as_array("points_m", points_m, (None, 2))
    if len(points) == 0:
        raise InvalidInput("points_m", "no point", "one x, z pair or more")
    check_number("within_m", within_m, "metres above 0", lambda metres: metres > 0)
    kept = _kept(points, within_m)
    while kept.sum() > MOST_CORNERS:
        within_m *= 2
        kept = _kept(points, within_m)
    corners: Float32 = points[kept]
    return corners


def _kept(points: Float32, within_m: float) -> np.ndarray:
    """(N,) bool: the ends and, recursively, the point of each span farthest from its line, if that is too far."""
    kept = np.zeros(len(points), bool)
    kept[[0, -1]] = True
    spans = [(0, len(points) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        begin, along = points[first].astype(np.float64), (points[last] - points[first]).astype(np.float64)
        away = points[first + 1 : last] - begin
        share = np.clip(away @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        off = np.hypot(*(away - share[:, None] * along).T)
        farthest = int(off.argmax())
        if off[farthest] > within_m:
            middle = first + 1 + farthest
            kept[middle] = True
            spans += [(first, middle), (middle, last)]
    return kept
