"""The words for what derived clips and the idle captures show, in the form of `motiongen_ardy.data.phrases`."""

from __future__ import annotations

SIDED: dict[str, tuple[str, ...]] = {
    "walk-curve-{side}": (
        "walk|walks|walking in a curve to the {side}",
        "walk|walks|walking along a curve to the {side}",
        "walk|walks|walking forward",
        "walk|walks|walking",
        "walk|walks|walking in an arc to the {side}",
    ),
    "run-curve-{side}": (
        "run|runs|running in a curve to the {side}",
        "run|runs|running",
        "run|runs|running forward",
        "run|runs|running in an arc to the {side}",
    ),
    "run-turn-{side}": (
        "turn|turns|turning {side} while running",
        "run|runs|running and {turn} {side}",
        "run|runs|running around a corner to the {side}",
    ),
    "turn-around-{side}": (
        "turn|turns|turning around to the {side}",
        "turn|turns|turning around",
        "make|makes|making a U-turn to the {side}",
        "turn|turns|turning back to the {side}",
    ),
    "turn-on-spot-{side}": (
        "turn|turns|turning {side} on the spot",
        "turn|turns|turning to the {side} in place",
        "turn|turns|turning {side} without walking away",
        "step|steps|stepping in place and {turn} {side}",
        "turn|turns|turning {side}",
    ),
    "start-turn-{side}": (
        "turn|turns|turning {side} and {start_walking}",
        "turn|turns|turning {side} and {walk} off",
        "walk|walks|walking off to the {side}",
    ),
    "walk-sideways-{side}": (
        "walk|walks|walking sideways to the {side}",
        "sidestep|sidesteps|sidestepping to the {side}",
        "step|steps|stepping sideways to the {side}",
        "strafe|strafes|strafing to the {side}",
        "walk|walks|walking",
    ),
    "walk-diagonal-{side}": (
        "walk|walks|walking diagonally forward to the {side}",
        "walk|walks|walking forward and to the {side} without turning",
        "walk|walks|walking",
    ),
    "walk-back-diagonal-{side}": (
        "walk|walks|walking diagonally backward to the {side}",
        "walk|walks|walking backward and to the {side} without turning",
        "walk|walks|walking",
    ),
}

PLAIN: dict[str, tuple[str, ...]] = {
    "idle": (
        "stand|stands|standing around",
        "stand|stands|standing and {wait}",
        "wait|waits|waiting",
        "stand|stands|standing idle",
        "stand|stands|standing",
        "idle|idles|idling",
        "stay|stays|staying in place",
    ),
    "walk-slow": (
        "walk|walks|walking slowly",
        "walk|walks|walking forward slowly",
        "walk|walks|walking at a slow pace",
        "walk|walks|walking forward",
    ),
    "walk-fast": (
        "walk|walks|walking fast",
        "walk|walks|walking forward quickly",
        "walk|walks|walking at a brisk pace",
        "walk|walks|walking forward",
    ),
    "run-slow": ("run|runs|running slowly", "jog|jogs|jogging slowly", "run|runs|running forward"),
    "run-fast": ("run|runs|running fast", "run|runs|running quickly", "run|runs|running forward"),
    "walk-weaving": (
        "walk|walks|walking in an S-curve",
        "walk|walks|walking along a winding path",
        "walk|walks|walking forward",
        "walk|walks|walking",
    ),
    "run-weaving": ("run|runs|running in an S-curve", "run|runs|running along a winding path", "run|runs|running"),
    "start-walk-stop": (
        "start|starts|starting to walk and {stop}",
        "walk|walks|walking a few steps and {stop}",
    ),
    "start-hop-stop": ("start|starts|starting to hop and {stop}", "hop|hops|hopping and {stop}"),
}  # fmt: skip
