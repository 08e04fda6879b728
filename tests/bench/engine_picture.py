"""The engine's table as a picture: characters of each contestant below the ceiling, and how soon edits show."""

from __future__ import annotations

from pathlib import Path

from tests.bench.engine_run import Report

_BAR, _CEILING, _HALF, _MOST = "#2f6db3", "#7c828b", "#9fc0e6", "#2f6db3"
TARGET_MS = 250


def draw(report: Report, path: Path) -> None:
    """Write a PNG. The null contestant has another scale, and is left out. Nothing is drawn without a contestant."""
    from matplotlib.figure import Figure

    found = [one for one in report.standings if one.name != "null"]
    if not found:
        return
    figure = Figure(figsize=(11, 4.2), dpi=110, layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2)
    names = [one.name for one in found]
    bars = left.bar(names, [one.characters for one in found], color=_BAR, width=0.6)
    left.bar_label(bars)
    most = 2 * max(one.rate.windows_per_s for one in report.ceilings)
    left.axhline(most, color=_CEILING, linestyle="--", linewidth=1)
    left.annotate(f"full batches without a clock: {most:.0f}", (0.02, most), xycoords=("axes fraction", "data"),
                  xytext=(0, 3), textcoords="offset points", color=_CEILING, fontsize=9)  # fmt: skip
    left.set_ylim(0, 1.12 * max(most, *(one.characters for one in found)))
    left.set_ylabel("characters in real time")
    left.set_title("characters with under 1 % of frames missing", fontsize=11)
    timed = [one for one in found if one.latency_ms(99) is not None]
    for percentile, color, offset in ((50, _HALF, -0.18), (99, _MOST, 0.18)):
        heights = [one.latency_ms(percentile) or 0.0 for one in timed]
        places = [number + offset for number in range(len(timed))]
        bars = right.bar(places, heights, width=0.34, color=color, label=f"p{percentile}")
        right.bar_label(bars, fmt="%.0f", fontsize=8)
    right.axhline(TARGET_MS, color=_CEILING, linestyle="--", linewidth=1)
    right.set_xticks(range(len(timed)), [f"{one.name}\n({one.at_load.characters})" for one in timed if one.at_load])
    right.set_yscale("log")
    right.set_ylabel("ms")
    right.set_title("edit to first changed frame, at 70 % of those characters", fontsize=11)
    right.legend(frameon=False)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    facts = report.facts
    figure.suptitle(
        f"{report.ceilings[0].model}, {report.habits.num_steps} steps, {facts['cores']}, {facts['processor']}",
        fontsize=10,
    )
    figure.savefig(path, format="png")
