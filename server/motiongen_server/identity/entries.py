"""Entries of the tenants' file, checked as they are taken out. Everything here raises ValueError, which says where."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def table(entry: Mapping[str, Any], known: set[str], where: str) -> Mapping[str, Any]:
    """A table that has no keys but those that are known."""
    unknown = sorted(set(entry) - known)
    if unknown:
        raise ValueError(f"{where} has {', '.join(unknown)}; known are {', '.join(sorted(known))}")
    return entry


def mapping(value: object, where: str) -> Mapping[str, Any]:
    """A table, of whatever keys. What else there is may be a secret that was put in the wrong place: it is not said."""
    if not isinstance(value, dict):
        raise ValueError(f"{where} must be a table, not a {type(value).__name__}")
    return value


def words(value: object, where: str) -> tuple[str, ...]:
    """A list of words, none of them empty."""
    if not isinstance(value, list) or not all(isinstance(word, str) and word for word in value):
        raise ValueError(f"{where} must be a list of words, not {value!r}")
    return tuple(value)


def word(value: object, where: str) -> str:
    """One word, which is not empty."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{where} must be a word, not {value!r}")
    return value


def number(value: object, least: float, most: float, where: str) -> float:
    """A number of that range; whole ones stay whole."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        raise ValueError(f"{where} is {value!r}; it must be a number from {least:g} to {most:.12g}")
    return value
