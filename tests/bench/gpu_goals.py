"""The goals for a GPU at the released size, and how far reports of `tests.bench.gpu_engine` are from them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

TIMES_SINGLE, EFFICIENCY, EDIT_P99_MS = 30.0, 0.45, 60.0
Report = dict[str, Any]


def reports_in(folder: Path) -> list[Report]:
    """The reports of all parts that were measured, by name."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*/engine.json"))]


def goals(reports: Sequence[Report]) -> list[str]:
    """A table of goals; "not measured" if the part that measures it is missing."""
    single, served = _characters(reports, "B0"), _characters(reports, "B5")
    times = served / single if single and served else None
    efficiency = max((one["efficiency"] for one in _ceilings(reports)), default=None)
    edit = next((one["edit_to_frame_ms"]["p99"] for one in _standings(reports, "B5")), None)
    rows = (
        ("characters against one window at a time", times, "{:.1f} times", TIMES_SINGLE, True),
        ("whole windows against the bfloat16 matrix product", efficiency, "{:.0%}", EFFICIENCY, True),
        ("edit to frame at 70 % load, p99", edit, "{:.0f} ms", EDIT_P99_MS, False),
    )
    lines = ["| goal | wanted | found | met |", "|---|---:|---:|---|"]
    for name, found, form, wanted, more in rows:
        told = "not measured" if found is None else form.format(found)
        met = "-" if found is None else "yes" if (found >= wanted if more else found <= wanted) else "no"
        lines.append(f"| {name} | {form.format(wanted)} | {told} | {met} |")
    return lines


def _standings(reports: Sequence[Report], name: str) -> Iterator[Report]:
    return (one for report in reports for one in report["standings"] if one["name"] == name)


def _characters(reports: Sequence[Report], name: str) -> int | None:
    return next((one["characters"] for one in _standings(reports, name)), None)


def _ceilings(reports: Sequence[Report]) -> Iterator[Report]:
    return (one for report in reports for one in report["ceilings"] if one["precision"] == "bfloat16")
