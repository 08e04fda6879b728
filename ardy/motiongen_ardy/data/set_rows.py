"""What `clips.json` of a set must hold: people mend captions by hand, and a slip must not train another motion."""

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
    """The first of the known fields that an object lacks, or that is of another type; None where all are there."""
    if not isinstance(entry, dict):
        return f"holds {str(entry)[:60]!r} instead of an object"
    for name, kinds in known.items():
        if type(entry.get(name)) not in kinds:
            wanted = " or ".join(kind.__name__ for kind in kinds)
            return f"{name} is {str(entry[name])[:60]!r}, no {wanted}" if name in entry else f"{name} is missing"
    return None


def rate_problem(fps: float) -> str | None:
    """What is wrong with a set's frame rate; None for a number above 0."""
    return None if 0 < fps < math.inf else f"fps is {fps}, no number above 0"


def rows_problem(rows: Sequence[Any]) -> str | None:
    """What is first wrong with the clips of a set, which lie one behind another; None where nothing is."""
    end = 0
    for number, row in enumerate(rows):
        problem = fields_problem(row, _CLIP) or _clip_problem(row, end)
        if problem:
            called = f" ({row['id'][:60]})" if isinstance(row, dict) and isinstance(row.get("id"), str) else ""
            return f"clip {number}{called}: {problem}"
        end += row["length"]
    return None


def _clip_problem(row: Mapping[str, Any], end: int) -> str | None:
    """end: frames of all clips before it."""
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
