"""Constraints whose frame or place the engine chooses, and root paths."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import Asked, Constraint, RootPath, RootTrajectory, Unplaced
from motiongen_server.rpc.convert.checks import frame_number, points, refuse
from motiongen_server.rpc.limits import MAX_SPEED_MPS

MAX_CORNERS = 256
MAX_SMOOTHING_M = 10.0
DEFAULT_SPEED_MPS = 1.2
DEFAULT_SMOOTHING_M = 0.3
MAX_WEIGHT = 10.0
SPEED_TOLERANCE = 1e-5


def asked_of(message: motion_pb2.Constraint, target: Constraint | RootPath, field: str) -> Asked:
    """The constraint with what it leaves to the engine. target: what it says about features. Raises EventRefused."""
    is_run = isinstance(target, RootTrajectory | RootPath)
    last_frame = None
    if message.HasField("last_frame"):
        if is_run:
            given = "a trajectory or a path has frames of its own"
            raise refuse("AMBIGUOUS_FRAMES", f"{field}.last_frame", given, "none beside a trajectory or a path")
        last_frame = frame_number(message.last_frame, f"{field}.last_frame")
        if last_frame < message.frame:
            given = f"it is {last_frame}, before frame {message.frame}"
            raise refuse("EMPTY_SPAN", f"{field}.last_frame", given, f"{message.frame} or later")
    if message.at_any_frame and (isinstance(target, RootTrajectory) or message.HasField("last_frame")):
        given = "frames are given as well"
        raise refuse("AMBIGUOUS_FRAMES", f"{field}.at_any_frame", given, "a target of one frame, without last_frame")
    if message.frame and (message.at_any_frame or isinstance(target, RootPath)):
        given = f"the frame is {message.frame}, but the target is to be met as soon as possible"
        raise refuse("AMBIGUOUS_FRAMES", f"{field}.frame", given, "0 with at_any_frame and for a path")
    weighted = replace(target, weight=_weight(message, field))
    is_relative, from_effect = message.relative_to_character, message.frames_from_effect
    is_open = is_relative or from_effect or message.at_any_frame or last_frame is not None
    if not is_open and not isinstance(weighted, RootPath):
        return weighted
    return Unplaced(weighted, from_effect, message.at_any_frame, last_frame, is_relative)


def _weight(message: motion_pb2.Constraint, field: str) -> float:
    if not message.HasField("weight"):
        return 1.0
    weight, allowed = message.weight, f"above 0, up to {MAX_WEIGHT:g}"
    if not math.isfinite(weight):
        raise refuse("NOT_FINITE", f"{field}.weight", f"the weight is {weight}", allowed)
    if not 0 < weight <= MAX_WEIGHT:
        raise refuse(
            "WEIGHT_OUT_OF_RANGE", f"{field}.weight", f"the weight is {weight:g}", f"above 0 to {MAX_WEIGHT:g}"
        )
    return float(weight)


def constraints_in(event: session_pb2.SessionEvent) -> Sequence[motion_pb2.Constraint]:
    """The constraints that an event sets."""
    return event.open.constraints if event.WhichOneof("event") == "open" else event.edit_constraints.upsert


def num_paths(constraints: Iterable[motion_pb2.Constraint]) -> int:
    """How many of the constraints are paths, whose places the engine works out."""
    return sum(constraint.HasField("root_path") for constraint in constraints)


def path_of(message: motion_pb2.RootPath, identifier: int, field: str) -> RootPath:
    """The engine's path. Raises EventRefused."""
    count = len(message.positions) // 2
    if not 1 <= count <= MAX_CORNERS or len(message.positions) % 2:
        given = f"there are {len(message.positions)} numbers"
        raise refuse("WRONG_LENGTH", f"{field}.positions", given, f"2 numbers (x, z) a corner, 1 to {MAX_CORNERS}")
    speed = message.speed_mps if message.HasField("speed_mps") else DEFAULT_SPEED_MPS
    smoothing = message.smoothing_m if message.HasField("smoothing_m") else DEFAULT_SMOOTHING_M
    for name, value in (("speed_mps", speed), ("smoothing_m", smoothing)):
        if not math.isfinite(value):
            raise refuse("NOT_FINITE", f"{field}.{name}", f"it is {value}", "a finite number")
    if not 0 < speed <= MAX_SPEED_MPS * (1 + SPEED_TOLERANCE):
        allowed = f"above 0, up to {MAX_SPEED_MPS:g} m/s"
        raise refuse("SPEED_OUT_OF_RANGE", f"{field}.speed_mps", f"the speed is {speed:g} m/s", allowed)
    if not 0 <= smoothing <= MAX_SMOOTHING_M:
        given = f"it is {smoothing:g} m"
        raise refuse("SMOOTHING_OUT_OF_RANGE", f"{field}.smoothing_m", given, f"0 to {MAX_SMOOTHING_M:g} m")
    return RootPath(identifier, points(message.positions, count, 2, f"{field}.positions"), speed, smoothing)
