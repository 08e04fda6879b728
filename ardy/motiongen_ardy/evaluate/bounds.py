"""The bounds that the built-in model must keep on moving clips, as served and raw."""

from __future__ import annotations

from motiongen_ardy.evaluate.figure import Bound

# Raw: without projection of the root, and without corrections of feet and joints.
_SERVED = {
    "waypoint on": Bound(most=0.03),
    "waypoint off": Bound(most=0.08),
    "waypoint beyond": Bound(most=0.10),
    "path clip": Bound(most=0.02),
    "path circle": Bound(most=0.03),
    "path angle": Bound(most=0.08),
    "heading": Bound(most=10.0),
    "keyframe": Bound(most=0.05),
    "hand": Bound(most=0.05),
    "foot": Bound(most=0.04),
    "head": Bound(most=8.0),
    "speed": Bound(least=0.9, most=1.1),
    "hips": Bound(most=5.0),
    "torn": Bound(most=0.02),
    "feet steady": Bound(most=0.10),
    "feet start": Bound(most=0.20),
    "glided": Bound(most=0.05),
    "reconstruction": Bound(most=0.02),
    "glide share": Bound(most=0.10),
    "R-precision": Bound(least=0.8),
}
_RAW = {
    "waypoint on": Bound(most=0.12),
    "waypoint off": Bound(most=0.12),
    "waypoint beyond": Bound(most=0.12),
    "path clip": Bound(most=0.04),
    "path circle": Bound(most=0.04),
    "feet steady": Bound(most=0.15),
}


def bounds(raw: bool) -> dict[str, Bound]:
    """Bounds by name, as served or without corrections."""
    return _SERVED | _RAW if raw else dict(_SERVED)
