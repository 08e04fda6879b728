"""The days as a picture: loads and refusals over time, with a column for each size of the fleet."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tests.scale.simulation.assumptions import Day
from tests.scale.simulation.day import Outcome
from tests.scale.simulation.fleet import Placement

COLOURS = {
    Placement.KEY: "tab:red",
    Placement.BOUNDED: "tab:orange",
    Placement.HINT: "tab:blue",
    Placement.LEAST: "tab:green",
}


def draw_days(outcomes: Mapping[tuple[int, int, Placement], Outcome], folder: Path) -> Path:
    """Draw the days of the first capacity. Returns the picture's path."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    capacity = next(iter(outcomes))[1]
    sizes = sorted({servers for servers, each, _ in outcomes if each == capacity})
    figure, rows = plt.subplots(2, len(sizes), figsize=(5 * len(sizes), 6.4), sharex=True, squeeze=False)
    day = Day()
    for column, size in enumerate(sizes):
        loads, refusals = rows[0][column], rows[1][column]
        for placement, colour in COLOURS.items():
            samples = outcomes[size, capacity, placement].samples
            minutes = [sample.at / 60 for sample in samples]
            loads.plot(minutes, [sample.most for sample in samples], color=colour, lw=0.9, label=placement.value)
            loads.plot(minutes, [sample.mean for sample in samples], color=colour, lw=0.9, ls=":")
            refusals.plot(minutes, [sample.refused / 5 for sample in samples], color=colour, lw=0.9)
        for axes in (loads, refusals):
            axes.axvspan(day.wave_at / 60, (day.wave_at + day.wave_s) / 60, color="0.9")
            axes.axvspan(day.zone_fails_at / 60, day.zone_back_at / 60, color="0.93")
            axes.axvline(day.upgrade_at / 60, color="0.6", lw=0.8)
            axes.set_xlim(day.warm_until / 60, day.ends_at / 60)
        loads.set_title(f"{size:,} servers of {capacity:,} characters")
        loads.set_ylim(0, 1.05)
        refusals.set_xlabel("minutes: wave, zone away, upgrade from the line on")
    rows[0][0].set_ylabel("load: of the fullest, dotted on average")
    rows[1][0].set_ylabel("clients refused, a second")
    rows[0][0].legend(loc="lower right", fontsize=8)
    figure.tight_layout()
    path = folder / "scale-days.png"
    figure.savefig(path, dpi=90)
    plt.close(figure)
    return path
