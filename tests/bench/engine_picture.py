"""Draws the engine's table: characters of each contestant compared with the ceiling, and how soon edits show.

`python -m tests.bench.engine_picture out/gpu/engine.json out/gpu/engine.png` draws measurements of another machine.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

_BAR, _CEILING, _HALF, _MOST = "#2f6db3", "#7c828b", "#9fc0e6", "#2f6db3"
TARGET_MS = 250


def draw(report: Mapping[str, Any], path: Path) -> None:
    """Write a PNG of the contents of engine.json. The null contestant is left out, because its scale differs.

    Without contestants nothing is drawn.
    """
    from matplotlib.figure import Figure

    found = [one for one in report["standings"] if one["name"] != "null"]
    if not found:
        return
    figure = Figure(figsize=(11, 4.2), dpi=110, layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2)
    served = report["settings"]
    fullest = [one for one in report["ceilings"] if one["model"] == report["ceilings"][0]["model"]]
    _draw_characters(left, found, 2 * max(one["windows_per_s"] for one in fullest))
    _draw_latencies(right, [one for one in found if one["edit_to_frame_ms"]["p99"] is not None])
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    facts = report["facts"]
    machine = facts.get("device") or f"{facts['processor']}, {facts['cores']}"
    if served["processor_time"]:
        machine = f"{facts['processor']}, one core's processor time"
    figure.suptitle(
        f"{fullest[0]['model']}, {served['num_steps']} steps, {served['precision']} - {machine}", fontsize=10
    )
    figure.savefig(path, format="png")


def _draw_characters(axes: Any, found: list[Any], ceiling: float) -> None:
    most = [one["characters"] for one in found]
    axes.bar_label(axes.bar([one["name"] for one in found], most, color=_BAR, width=0.6))
    axes.axhline(ceiling, color=_CEILING, linestyle="--", linewidth=1)
    axes.annotate(
        f"full batches without a clock: {ceiling:.0f}",
        (0.02, ceiling),
        xycoords=("axes fraction", "data"),
        xytext=(0, 3),
        textcoords="offset points",
        color=_CEILING,
        fontsize=9,
    )
    axes.set_ylim(0, 1.12 * max(ceiling, *most))
    axes.set_ylabel("characters in real time")
    axes.set_title("characters with under 1 % of frames missing", fontsize=11)


def _draw_latencies(axes: Any, found: list[Any]) -> None:
    for percentile, color, offset in (("p50", _HALF, -0.18), ("p99", _MOST, 0.18)):
        heights = [one["edit_to_frame_ms"][percentile] for one in found]
        places = [number + offset for number in range(len(found))]
        axes.bar_label(axes.bar(places, heights, width=0.34, color=color, label=percentile), fmt="%.0f", fontsize=8)
    axes.axhline(TARGET_MS, color=_CEILING, linestyle="--", linewidth=1, label=f"{TARGET_MS} ms")
    axes.set_xticks(range(len(found)), [f"{one['name']}\n({one['at_load']['characters']})" for one in found])
    axes.set_ylim(0, 1.35 * max([TARGET_MS, *(one["edit_to_frame_ms"]["p99"] for one in found)]))
    axes.set_ylabel("ms")
    axes.set_title("edit to first changed frame, at 70 % of those characters", fontsize=11)
    axes.legend(frameon=False, ncols=3, loc="upper right")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.engine_picture", description=__doc__)
    parser.add_argument("engine", type=Path, metavar="ENGINE.json", help="the measurements")
    parser.add_argument("picture", type=Path, metavar="PICTURE.png", help="where the picture is written")
    given = parser.parse_args(arguments)
    draw(json.loads(given.engine.read_text(encoding="utf-8")), given.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
