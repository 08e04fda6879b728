"""Values of a message from a browser, checked: each reader returns the value or raises InvalidInput."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from motiongen_client.errors import InvalidInput

Message = Mapping[str, Any]


def number(message: Message, name: str, default: float | None = None) -> float:
    """A finite number."""
    value = message.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InvalidInput(name, value, "a finite number")
    return float(value)


def optional_number(message: Message, name: str) -> float | None:
    """A finite number, or None where it is absent or null."""
    return None if message.get(name) is None else number(message, name)


def whole(message: Message, name: str, least: int = 0, most: int = 1 << 53, default: int | None = None) -> int:
    """A whole number from `least` to `most`."""
    value = message.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise InvalidInput(name, value, f"a whole number from {least} to {most}")
    return value


def optional_whole(message: Message, name: str, least: int = 0, most: int = 1 << 53) -> int | None:
    """A whole number from `least` to `most`, or None where it is absent or null."""
    return None if message.get(name) is None else whole(message, name, least, most)


def text(message: Message, name: str, default: str | None = None) -> str:
    """A string."""
    value = message.get(name, default)
    if not isinstance(value, str):
        raise InvalidInput(name, value, "a text")
    return value


def flag(message: Message, name: str, default: bool = False) -> bool:
    """True or false."""
    value = message.get(name, default)
    if not isinstance(value, bool):
        raise InvalidInput(name, value, "true or false")
    return value


def mapping(message: Message, name: str) -> Message:
    """An object."""
    value = message.get(name)
    if not isinstance(value, dict):
        raise InvalidInput(name, value, "an object")
    return value


def wholes(message: Message, name: str) -> list[int]:
    """A list of whole numbers of 0 and more."""
    value = message.get(name)
    if not isinstance(value, list) or any(isinstance(n, bool) or not isinstance(n, int) or n < 0 for n in value):
        raise InvalidInput(name, value, "a list of whole numbers of 0 or more")
    return value
