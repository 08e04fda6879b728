"""Checks of single fields; each raises EventRefused, which names the field and the values that are allowed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import Code, Float32Array
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.limits import MAX_COORDINATE_M, MAX_FRAME


def refuse(reason: str, field: str, message: str, allowed: str, code: Code = Code.INVALID_ARGUMENT) -> EventRefused:
    """The refusal of a field's value."""
    return EventRefused(code, reason, message, field=field, allowed=allowed)


def check_range(value: int, least: int, most: int, reason: str, field: str) -> None:
    if not least <= value <= most:
        raise refuse(reason, field, f"{field.rpartition('.')[2]} is {value}", f"{least} to {most}")


def heading_of(
    message: motion_pb2.Waypoint | motion_pb2.FootContact | session_pb2.SetVelocity | session_pb2.StartPose, field: str
) -> float | None:
    if not message.HasField("heading"):
        return None
    return finite_heading(message.heading, field)


def finite_heading(heading: float, field: str) -> float:
    """The heading modulo one turn, with its sign: after many turns float32 has no precision. field: of its message."""
    if not math.isfinite(heading):
        raise refuse("NOT_FINITE", f"{field}.heading", f"the heading is {heading}", "finite radians")
    return math.fmod(heading, math.tau)


def finite_headings(headings: Float32Array, field: str) -> Float32Array:
    """The same for several headings (T). field: the path of their list."""
    check_finite(headings, field, "finite radians")
    return np.fmod(headings.astype(np.float64), math.tau).astype(np.float32)


def number_array(values: Sequence[float], count: int, field: str, allowed: str) -> Float32Array:
    if len(values) != count:
        raise refuse("WRONG_LENGTH", field, f"there are {len(values)} numbers", allowed)
    return np.array(values, dtype=np.float32)


def points(values: Sequence[float], count: int, width: int, field: str) -> Float32Array:
    numbers = number_array(values, count * width, field, f"{count * width} numbers, {width} for each of {count}")
    check_coordinates(numbers, field)
    return numbers.reshape(count, width)


def check_coordinates(values: Iterable[float], field: str) -> None:
    numbers = np.array(values, dtype=np.float64)
    allowed = f"finite metres within +-{MAX_COORDINATE_M:g}"
    check_finite(numbers, field, allowed)
    if numbers.size and float(np.abs(numbers).max()) > MAX_COORDINATE_M:
        largest = numbers[np.abs(numbers).argmax()]
        raise refuse("COORDINATE_OUT_OF_RANGE", field, f"a coordinate is {largest:g} m", allowed)


def check_finite(numbers: NDArray[np.floating], field: str, allowed: str) -> None:
    bad = numbers[~np.isfinite(numbers)]
    if bad.size:
        raise refuse("NOT_FINITE", field, f"a number is {bad.flat[0]}", allowed)


def frame_number(value: int, field: str) -> int:
    if value > MAX_FRAME:
        raise refuse("FRAME_OUT_OF_RANGE", field, f"the frame is {value}", f"0 to {MAX_FRAME}")
    return value


def identifier_of(value: int, field: str) -> int:
    if value == 0:
        raise refuse("INVALID_ID", field, "the id is 0", "1 or more")
    return value


def identifiers_of(values: Sequence[int], most: int, reason: str, field: str) -> tuple[int, ...]:
    """Ids of what is to be removed; refused if there are more than a session can have."""
    check_count(values, most, reason, field)
    return tuple(identifier_of(value, f"{field}[{index}]") for index, value in enumerate(values))


def check_count(values: Sequence[object], most: int, reason: str, field: str) -> None:
    if len(values) > most:
        raise refuse(reason, field, f"there are {len(values)}", f"at most {most}", Code.RESOURCE_EXHAUSTED)
