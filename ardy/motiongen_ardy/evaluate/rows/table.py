"""The parts of the evaluation by name, in the order of the table."""

from __future__ import annotations

from collections.abc import Callable

from motiongen_ardy.evaluate.context import Context
from motiongen_ardy.evaluate.rows import (
    feet,
    matching,
    paths,
    poses,
    seams,
    sessions,
    short_ways,
    turning,
    velocity,
    waypoints,
)

FAMILIES: dict[str, Callable[[Context], None]] = {
    "waypoint": waypoints.add,
    "path": paths.add,
    "pose": poses.add,
    "velocity": velocity.add,
    "feet": feet.add,
    "short": short_ways.add,
    "seam": seams.add,
    "text": turning.add,
    "matching": matching.add,
    "session": sessions.add,
}
