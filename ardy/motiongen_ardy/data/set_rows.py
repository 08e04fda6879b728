"""Checks `clips.json` of a set: captions are edited by hand, and a slip must not go unnoticed into training."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

TOP_FIELDS: Mapping[str, tuple[type, ...]] = {
    "skeleton": (str,), "fps": (int, float), "skipped": (list,), "clips": (list,),
}  # fmt: skip
_CLIP: Mapping[str, tuple[type, ...]] = {
    "id": (str,), "dataset": (str,), "content": (str,), "style": (str,), "split": (str,), "start": (int,),
    "length": (int,), "captions": (list,), "segments": (list,), "mirror_allowed": (bool,), "derived_from": (str,),
    "flags": (list,), "figures": (dict,),
}  # fmt: skip
_SEGMENT: Mapping[str, tuple[type, ...]] = {"start": (int,), "length": (int,), "content": (str,), "captions": (list,)}


def fields_problem(entry: object, known: Mapping[str, tuple[type, ...]]) -> str | None:
    """What is wrong with the first known field that is missing or has another type; None if all are right."""
    if not isinstance(entry, dict):
        return f"holds {str(entry)[:60]!r} instead of an object"
    for name, kinds in known.items():
        if type(entry.get(name)) not in kinds:
            wanted = " or ".join(kind.__name__ for kind in kinds)
            return f"{name} is {str(entry[name])[:60]!r}, no {wanted}" if name in entry else f"{name} is missing"
    return None


def rate_problem(fps: float) -> str | None:
    """What is wrong with a set's frame rate; None if it is a finite number above 0."""
    return None if 0 < fps < math.inf else f"fps is {fps}, no number above 0"


def rows_problem(rows: Sequence[Any]) -> str | None:
    """The first problem of the clips of a set, which must be contiguous; None if there is none."""
    end = 0
    for number, row in enumerate(rows):
        problem = fields_problem(row, _CLIP) or _clip_problem(row, end)
        if problem:
            called = f" ({row['id'][:60]})" if isinstance(row, dict) and isinstance(row.get("id"), str) else ""
            return f"clip {number}{called}: {problem}"
        end += row["length"]
    return None


def _clip_problem(row: Mapping[str, Any], end: int) -> str | None:
    """The first problem of one clip. end: the number of frames in all clips before it."""
    if row["start"] != end or row["length"] < 1:
        return f"it has {row['length']} frames from {row['start']} on; it starts at {end}, where the last one ends"
    for part in (row, *row["segments"]):
        problem = fields_problem(part, _SEGMENT)
        if problem:
            return f"a segment: {problem}"
        if not all(isinstance(caption, str) for caption in part["captions"]):
            return "captions are no list of texts"
        if part is not row and not 0 <= part["start"] < part["start"] + part["length"] <= row["length"]:
            return f"a segment of {part['length']} frames from {part['start']} on, of {row['length']}"
    return None
