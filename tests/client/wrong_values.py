"""Values of wrong types, which arguments accept which of them, and checks that the others are refused."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from motiongen_client import InvalidInput, Waypoint

VALUES: dict[str, Any] = {
    "None": None,
    "text": "3",
    "": "",
    "no text": "\ud800",
    "bytes": b"3",
    "float": 1.5,
    "bool": True,
    "nan": float("nan"),
    "inf": float("inf"),
    "negative": -1,
    "huge": 2**70,
    "endless": 10**400,
    "complex": 1j,
    "[]": [],
    "numbers": [1.0],
    "texts": ["a"],
    "nothings": [None],
    "{}": {},
    "object": object(),
    "array": np.array([1.0, np.nan]),
    "array of texts": np.array(["1", "2"]),
    "array of no dimension": np.array(3.0),
    "function": lambda *_: "a",
}
NUMBER = {"float", "negative", "huge"}
ABOVE_0 = {"float", "huge"}
ANGLE = {"float"}
NONE = {"None"}
WHOLE: set[str] = set()  # none of the values is a whole number in the allowed range
FLAG = {"bool"}
TEXT = {"text", ""}
NO_ITEMS = {"[]", "{}"}
FINE = Waypoint(300, 1.0, 2.0)
TOLERANCES = {"tolerance_m": ABOVE_0 | NONE, "tolerance_rad": ANGLE | NONE}
PLACE = {"x_m": NUMBER, "z_m": NUMBER, "heading_rad": NUMBER | NONE}


@dataclass
class Made:
    """A call, its valid arguments, and which of `VALUES` each argument accepts too."""

    of: Callable[..., object]
    valid: dict[str, Any]
    takes: dict[str, set[str]] = field(default_factory=dict)


def wrong(made: Made) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Each argument with every value that it does not accept: its name, the name of the value, and all arguments."""
    for name, taken in made.takes.items():
        for label in VALUES.keys() - taken:
            yield name, label, {**made.valid, name: VALUES[label]}


def taken(made: Made) -> Iterator[dict[str, Any]]:
    """Each argument with every value that it accepts."""
    for name, labels in made.takes.items():
        for label in labels:
            yield {**made.valid, name: VALUES[label]}


def is_refused(make: Callable[[], object]) -> bool:
    """Whether it raises an InvalidInput that says what is allowed. Other exceptions are passed on."""
    try:
        make()
    except InvalidInput as refusal:
        return "was given; allowed is " in str(refusal)
    return False


async def is_refused_when_awaited(make: Callable[[], Awaitable[object]]) -> bool:
    """As `is_refused`, for an awaitable."""
    try:
        await make()
    except InvalidInput as refusal:
        return "was given; allowed is " in str(refusal)
    return False


def name_of(made: Made) -> str:
    return getattr(made.of, "__qualname__", "")
