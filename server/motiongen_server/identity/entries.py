"""Checks of entries in the tenants' file. Every function raises ValueError that says where the mistake is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def table(entry: Mapping[str, Any], known: set[str], where: str) -> Mapping[str, Any]:
    """A table, if all its keys are known."""
    unknown = sorted(set(entry) - known)
    if unknown:
        raise ValueError(f"{where} has {', '.join(unknown)}; known are {', '.join(sorted(known))}")
    return entry


def mapping(value: object, where: str) -> Mapping[str, Any]:
    """A table, with any keys. The error does not repeat another value: it may be a misplaced secret."""
    if not isinstance(value, dict):
        raise ValueError(f"{where} must be a table, not a {type(value).__name__}")
    return value


def words(value: object, where: str) -> tuple[str, ...]:
    """A list of strings, none of them empty."""
    if not isinstance(value, list) or not all(isinstance(word, str) and word for word in value):
        raise ValueError(f"{where} must be a list of non-empty strings, not {value!r}")
    return tuple(value)


def word(value: object, where: str) -> str:
    """A string that is not empty."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{where} must be a non-empty string, not {value!r}")
    return value


def number(value: object, least: float, most: float, where: str) -> float:
    """A number from `least` to `most`; integers stay integers."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        raise ValueError(f"{where} is {value!r}; it must be a number from {least:g} to {most:.12g}")
    return value
