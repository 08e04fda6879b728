"""Steering: a stick or a drawn line, as a player gives them, in the world's axes. Pure.

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
from motiongen_client.types import as_array, check_finite

MOST_CORNERS = 256
"""Of one `RootPath`."""


def stick_velocity(
    right: float,
    forward: float,
    *,
    camera_heading_rad: float = 0.0,
    speed_mps: float = 3.0,
    dead_zone: float = 0.15,
) -> tuple[float, float]:
    """World x and z in metres a second, for `Session.set_velocity`, of a stick as the player sees it.

    right, forward: -1 to 1; pushed into a corner it is no faster than along an axis. camera_heading_rad: where the
    camera looks over the ground, 0 toward +Z. speed_mps: of a stick pushed all the way. dead_zone: what counts as let
    go; beyond it speed begins at 0, so that nobody jumps into a walk. Raises InvalidInput.
    """
    for name, value in (("right", right), ("forward", forward), ("camera_heading_rad", camera_heading_rad)):
        check_finite(name, value)
    if not 0 <= dead_zone < 1:
        raise InvalidInput("dead_zone", dead_zone, "0 or more, below 1")
    push = math.hypot(right, forward)
    if push <= dead_zone:
        return 0.0, 0.0
    speed = speed_mps * (min(push, 1.0) - dead_zone) / (1.0 - dead_zone)
    ahead, aside = speed * forward / push, speed * right / push
    sin, cos = math.sin(camera_heading_rad), math.cos(camera_heading_rad)
    # +X is to the left of who looks along +Z.
    return ahead * sin - aside * cos, ahead * cos + aside * sin


def camera_relative(right_m: float, forward_m: float, camera_heading_rad: float) -> tuple[float, float]:
    """World x and z of a distance as the player sees it: to the right of where the camera looks, and ahead."""
    sin, cos = math.sin(camera_heading_rad), math.cos(camera_heading_rad)
    return forward_m * sin - right_m * cos, forward_m * cos + right_m * sin


def drawn_corners(points_m: ArrayLike, *, within_m: float = 0.1) -> Float32:
    """Corners (K, 2), K at most 256, of a line that was drawn through points_m (N, 2), world x, z in metres.

    No point is farther than within_m from the line through them (Ramer 1972, Douglas and Peucker 1973); where that
    takes more corners than a path may have, it is twice as far, and so on.
    """
    points = as_array("points_m", points_m, (None, 2))
    if len(points) == 0:
        raise InvalidInput("points_m", "no point", "one x, z pair or more")
    if not within_m > 0:
        raise InvalidInput("within_m", within_m, "metres above 0")
    kept = _kept(points, within_m)
    while kept.sum() > MOST_CORNERS:
        within_m *= 2
        kept = _kept(points, within_m)
    corners: Float32 = points[kept]
    return corners


def _kept(points: Float32, within_m: float) -> np.ndarray:
    """(N) bool: the ends, and of every span the point that is farthest from its line, if it is too far."""
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
