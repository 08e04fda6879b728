"""A run as a picture: latencies by percentile, how early chunks came, frames by second, the load's own lag.

Needs matplotlib: `pip install 'motiongen-tools[bench]'`.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from motiongen_client.errors import MissingExtra
from motiongen_tools.bench.recorder import ALL, ANSWER, EVENT, GENERATOR, GENERATOR_LAGS, LATENESS, OPEN, SCREEN, SLACK
from motiongen_tools.bench.result import Result
from motiongen_tools.bench.search import Found
from motiongen_tools.bench.terminal import LATENCY_NAMES
from motiongen_tools.picture_text import as_written

if TYPE_CHECKING:
    from hdrh.histogram import HdrHistogram
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK, _QUIET, _GRID = "#1f2328", "#7c828b", "#eceef0"
_BLUE, _RED, _GREEN, _ORANGE, _VIOLET = "#2f6db3", "#cf4a4a", "#1a9850", "#d98a1f", "#7a4fb5"
_COLOURS = (_BLUE, _ORANGE, _GREEN, _VIOLET, _RED)
_PERCENTILES = (0.0, *(100 * (1 - 10 ** (-exponent / 20)) for exponent in range(1, 81)))
_FEW = 10  # chunks, up to which their scale is linear
_TICKS = (50, 90, 99, 99.9, 99.99)


def draw_run(result: Result) -> Figure:
    """A figure of six panels for one run."""
    figure = _new_figure((13.5, 10.5))
    grid = figure.add_gridspec(3, 2, height_ratios=[1, 1, 1.05])
    groups = result.groups()
    events = [(group, result.recorder.histogram(EVENT, group)) for group in groups]
    _percentiles(figure.add_subplot(grid[0, 0]), LATENCY_NAMES[EVENT], events)
    others = [(LATENCY_NAMES[what], result.recorder.histogram(what)) for what in (OPEN, SCREEN, ANSWER)]
    _percentiles(figure.add_subplot(grid[0, 1]), "other latencies", others)
    _earliness(figure.add_subplot(grid[1, 0]), result)
    lags = [(what.replace("_", " "), result.recorder.histogram(what, GENERATOR)) for what in GENERATOR_LAGS]
    axes = figure.add_subplot(grid[1, 1])
    _percentiles(axes, "lag of the load itself", lags)
    axes.axhline(result.standard.max_lag_ms, color=_RED, linewidth=1, linestyle=(0, (4, 3)))
    axes.axvline(_place(99), color=_RED, linewidth=1, linestyle=(0, (4, 3)))
    _by_second(figure.add_subplot(grid[2, :]), result)
    void = "VOID, the load was late.  " if result.void_reasons() else ""
    figure.suptitle(as_written(void + result.headline()), x=0.01, ha="left", fontsize=13, color=_RED if void else _INK)
    return figure


def draw_search(found: Found, max_miss_ratio: float) -> Figure:
    """Missed frames by number of characters, one point per trial."""
    figure = _new_figure((13.5, 4.2))
    axes = figure.add_subplot()
    trials, allowed = found.trials, 100 * max_miss_ratio
    kinds = (
        ("served in full", _GREEN, "o", [trial for trial in trials if trial.passed]),
        ("not served in full", _RED, "X", [trial for trial in trials if trial.shortfalls and not trial.void]),
        ("void", _QUIET, "s", [trial for trial in trials if trial.void]),
    )
    for name, colour, marker, those in kinds:
        if those:
            numbers, misses = [trial.characters for trial in those], [100 * trial.miss_ratio for trial in those]
            axes.scatter(numbers, misses, s=50, c=colour, marker=marker, label=name, clip_on=False, zorder=3)
    axes.axhline(allowed, color=_RED, linewidth=1, linestyle=(0, (4, 3)))
    if found.characters:
        axes.axvline(found.characters, color=_GREEN, linewidth=1, linestyle=(0, (4, 3)))
    axes.set_yscale("symlog", linthresh=0.1)
    axes.set_ylim(0, 100)
    axes.set_yticks([0, 0.1, 1, 10, 100], ["0", "0.1", "1", "10", "100"])
    axes.set_xlim(left=0)
    title = f"{found.characters} characters {'or more ' if found.limited_by_generator else ''}are served in full"
    _dress(axes, title, "characters", "frames missed, %")
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def as_png(figure: Figure) -> bytes:
    return _saved(figure, "png")


def as_svg(figure: Figure) -> str:
    """The figure as an element to put into a page."""
    text = _saved(figure, "svg").decode()
    return text[text.index("<svg") :]


def _saved(figure: Figure, kind: str) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind)
    return buffer.getvalue()


def _new_figure(inches: tuple[float, float]) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtra("drawing a report", "matplotlib", "bench") from None
    return Figure(figsize=inches, dpi=110, layout="constrained", facecolor="white")


def _place(percentile: float) -> float:
    """The place of a percentile on a logarithmic axis, on which 90, 99, 99.9 and so on are equally far apart."""
    return 1 / (1 - percentile / 100)


def _percentiles(axes: Axes, title: str, named: Sequence[tuple[str, HdrHistogram]]) -> None:
    """One line per histogram, milliseconds by percentile, up to the percentile that its count can resolve."""
    top = 10.0
    for (name, histogram), colour in zip(named, _COLOURS, strict=False):
        count = histogram.get_total_count()
        if not count:
            continue
        known = [percentile for percentile in _PERCENTILES if _place(percentile) <= max(count, 1)]
        value_at = histogram.get_percentile_to_value_dict(known)
        values = [value_at[percentile] / 1000 for percentile in known]
        places = [_place(percentile) for percentile in known]
        top = max(top, places[-1])
        label = as_written(f"{name} ({count:,})")
        shade = _INK if name == ALL else colour
        axes.plot(places, values, color=shade, linewidth=1.6, label=label)
        axes.plot(places[-1:], [histogram.get_max_value() / 1000], "o", color=shade, markersize=3.5)
    axes.set_xscale("log")
    axes.set_xlim(1, top * 1.15)
    ticks = [tick for tick in _TICKS if _place(tick) <= top]
    axes.set_xticks([_place(tick) for tick in ticks], [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_ylim(0, axes.get_ylim()[1] * 1.25)  # room for the legend
    _dress(axes, title, "percentile", "ms")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8, loc="upper left")


def _earliness(axes: Axes, result: Result) -> None:
    """How long before playback needed them chunks arrived; left of 0, how long after."""
    early, late = result.recorder.histogram(SLACK), result.recorder.histogram(LATENESS)
    values = [
        (item.value_iterated_to / 1000, item.count_at_value_iterated_to) for item in early.get_recorded_iterator()
    ]
    values = [(value, count) for value, count in values if value > 0.001]
    values += [
        (-item.value_iterated_to / 1000, item.count_at_value_iterated_to)
        for item in late.get_recorded_iterator()
        if item.value_iterated_to > 1
    ]
    if values:
        places, weights = zip(*values, strict=True)
        edges = np.linspace(min(0.0, *places), max(1.0, *places), 61)
        counts, _ = np.histogram(places, edges, weights=weights)
        colours = [_RED if left < 0 else _BLUE for left in edges[:-1]]
        axes.bar(edges[:-1], counts, width=np.diff(edges), align="edge", color=colours)
        if counts.max() > _FEW:
            axes.set_yscale("symlog", linthresh=_FEW)
        else:  # there would be no power of ten to mark
            axes.locator_params(axis="y", integer=True)
    axes.axvline(0, color=_INK, linewidth=1)
    _dress(axes, "chunks before they were needed (red: after)", "ms", "chunks")


def _by_second(axes: Axes, result: Result) -> None:
    """Frames due, received and missed, and edits, over the run. Times that were not measured are grey."""
    phases = result.phases
    rows = {name: list(result.recorder.by_second(name)) for name in ("due", "frames", "missed", "edits")}
    seconds = range(len(rows["due"]))
    axes.axvspan(0, phases.measure_from_s, color=_GRID, linewidth=0)
    axes.axvspan(phases.measure_to_s, len(seconds), color=_GRID, linewidth=0)
    axes.bar([second + 0.5 for second in seconds], rows["missed"], width=1.0, color=_RED, label="missed")
    for name, colour in (("due", _INK), ("frames", _BLUE)):
        label = "received" if name == "frames" else name
        axes.stairs(rows[name], range(len(seconds) + 1), baseline=None, color=colour, linewidth=1.5, label=label)
    axes.set_xlim(0, len(seconds))
    axes.set_ylim(0, max([*rows["due"], *rows["frames"], 1]) * 1.2)
    _dress(axes, "frames by second", "seconds from the start; grey is not measured", "frames")
    edits = axes.twinx()
    edges = range(len(seconds) + 1)
    edits.stairs(rows["edits"], edges, baseline=None, color=_ORANGE, linewidth=1.2, label="edits, right")
    edits.set_ylim(0, max([*rows["edits"], 1]) * 4)
    edits.set_ylabel("edits", fontsize=8, color=_QUIET)
    edits.tick_params(labelsize=8, colors=_QUIET, length=2)
    edits.spines[:].set_visible(False)
    handles = [pair for one in (axes, edits) for pair in zip(*one.get_legend_handles_labels(), strict=True)]
    axes.legend(*zip(*handles, strict=True), frameon=False, fontsize=8, loc="upper left", ncols=4)


def _dress(axes: Axes, title: str, x_label: str, y_label: str) -> None:
    axes.set_title(title, loc="left", fontsize=10, color=_INK)
    axes.set_xlabel(x_label, fontsize=8, color=_QUIET)
    axes.set_ylabel(y_label, fontsize=8, color=_QUIET)
    axes.tick_params(labelsize=8, colors=_QUIET, length=2)
    axes.grid(color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color("#c9ccd1")
