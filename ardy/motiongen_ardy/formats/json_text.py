"""Untrusted JSON: bounded, no NaN, no duplicate names, and numeric arrays of exactly the required shape."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from typing import Any, NoReturn

import numpy as np

from motiongen_ardy.formats.bounded import MAX_JSON_BYTES
from motiongen_ardy.formats.errors import FormatError, shortened


class NumbersError(ValueError):
    """Raised for a value that is not an array of finite numbers of the wanted shape; the message says what it is."""


def parse_json(text: str | bytes, source: object) -> Any:
    """The content of JSON text. Raises FormatError if it is not JSON, nested too deeply, or has duplicate names."""
    if len(text) > MAX_JSON_BYTES:
        raise FormatError(source, f"{len(text)} bytes of JSON", f"at most {MAX_JSON_BYTES} are read")

    def no_constant(name: str) -> NoReturn:
        raise FormatError(source, f"the number {name}", "numbers must be finite")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        fields = dict(pairs)
        if len(fields) != len(pairs):
            counts = Counter(name for name, _ in pairs)
            twice = next(name for name, count in counts.items() if count > 1)
            raise FormatError(source, f"an object has {shortened(twice)} twice", "name each field once")
        return fields

    try:
        return json.loads(text, parse_constant=no_constant, object_pairs_hook=unique)
    except FormatError:
        raise
    except RecursionError:
        raise FormatError(source, "JSON nested too deeply", "no file read here needs more than ten levels") from None
    except ValueError as error:  # includes numbers of thousands of digits, and bytes that are not text
        raise FormatError(source, f"not JSON: {str(error)[:200]}", "give a JSON file") from None


def numbers(value: object, shape: tuple[int, ...]) -> np.ndarray:
    """The nested lists `value` as float64 of exactly this shape.

    Lists are traversed only as deep and as wide as the shape; strings and booleans do not count as numbers. Raises
    NumbersError.
    """
    flat: list[float] = []
    _flatten(value, shape, (), flat)
    return np.array(flat, dtype=np.float64).reshape(shape)


def _flatten(value: object, shape: tuple[int, ...], place: tuple[int, ...], flat: list[float]) -> None:
    where = f" at {list(place)}" if place else ""
    if not shape:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise NumbersError(f"not an array of numbers: {shortened(value)}{where}")
        try:
            number = float(value)
        except OverflowError:
            number = float("inf")
        if not np.isfinite(number):
            raise NumbersError(f"holds NaN or infinite numbers{where}; every one must be finite")
        flat.append(number)
        return
    if not isinstance(value, list):
        raise NumbersError(f"not an array of numbers: {shortened(value)}{where} instead of a list of {shape[0]}")
    if len(value) != shape[0]:
        raise NumbersError(f"not an array of numbers of shape {shape}{where}: a list of {len(value)}")
    for index, entry in enumerate(value):
        _flatten(entry, shape[1:], (*place, index), flat)


def write_json(content: Iterable[Any]) -> str:
    """JSON text, one top-level entry per line, numbers with full precision. Raises ValueError for NaN."""
    if isinstance(content, dict):
        lines = (f"{json.dumps(name)}: {json.dumps(value, allow_nan=False)}" for name, value in content.items())
        return "{\n" + ",\n".join(lines) + "\n}\n"
    return "[\n" + ",\n".join(json.dumps(entry, allow_nan=False) for entry in content) + "\n]\n"
