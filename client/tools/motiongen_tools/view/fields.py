"""Checked access to the values of a browser's message: each reader returns the value or raises InvalidInput."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from motiongen_client.errors import InvalidInput

Message = Mapping[str, Any]
MOST_ID = (1 << 32) - 1
"""Greatest id of prompts, constraints and joints, which the contract stores in 32 bits."""


def number(message: Message, name: str, default: float | None = None) -> float:
    """A finite number."""
    value = message.get(name, default)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) <= sys.float_info.max:  # JSON's whole numbers have no bound
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
    """A string that can be encoded as UTF-8."""
    value = message.get(name, default)
    if not isinstance(value, str) or any("\ud800" <= sign <= "\udfff" for sign in value):
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


def ids(message: Message, name: str) -> list[int]:
    """A list of whole numbers that can be ids of prompts, constraints or joints."""
    value = message.get(name)
    if not isinstance(value, list) or not all(type(each) is int and 0 <= each <= MOST_ID for each in value):
        raise InvalidInput(name, value, f"a list of whole numbers from 0 to {MOST_ID}")
    return value
