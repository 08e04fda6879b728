"""A run on the terminal: its progress, its figures, and the result of a search."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from motiongen_tools.bench.load import Load, Progress
from motiongen_tools.bench.recorder import (
    ALL,
    ANSWER,
    EVENT,
    GENERATOR,
    GENERATOR_LAGS,
    OPEN,
    ROUND_TRIP,
    SCREEN,
    STREAMS,
)
from motiongen_tools.bench.result import Result
from motiongen_tools.bench.search import Found, Trial
from motiongen_tools.console import make_progress, make_table

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

LATENCY_NAMES = {
    OPEN: "open to first frame",
    EVENT: "event to first changed frame",
    SCREEN: "event to screen",
    ANSWER: "event to answer",
}


@contextmanager
def showing(console: Console, load: Load) -> Iterator[Callable[[Progress], None]]:
    """Show a bar during a run. Yields the function that takes the progress of each process."""
    phases, latest = load.schedule().phases, dict[int, Progress]()
    bars = make_progress(console)
    bars.disable = not console.is_terminal  # otherwise each bar leaves an empty line in a log
    with bars:
        bar = bars.add_task(f"{load.characters} characters", total=phases.end_s, state="starting")

        def tell(progress: Progress) -> None:
            latest[progress.process] = progress
            at_s = min(each.at_s for each in latest.values())
            name = (
                "warming up"
                if at_s < phases.measure_from_s
                else "measuring"
                if at_s < phases.measure_to_s
                else "ending"
            )
            playing, missed = (sum(getattr(each, what) for each in latest.values()) for what in ("playing", "missed"))
            bars.update(bar, completed=at_s, state=f"{name}: {playing} playing, {missed} frames missed in a second")

        yield tell


def describe(load: Load) -> str:
    """What is about to be run."""
    scenario = load.scenario
    return (
        f"{scenario.name} (revision {scenario.revision}): {scenario.description}\n"
        f"seed {load.seed}, server {load.address}"
    )


def print_result(console: Console, result: Result) -> None:
    """Print tables of figures and latencies, and whether they count."""
    console.print(_table(("measured", *result.groups()), figure_rows(result)))
    console.print(_table(("latency, ms", *LATENCY_COLUMNS), latency_rows(result)))
    console.print(_table(("lag of the load, ms", *LATENCY_COLUMNS), generator_rows(result)))
    console.print(use_line(result), soft_wrap=True)
    counts = (f"{name.replace('_', ' ')} {count:,}" for name, count in result.counts())
    console.print("; ".join(counts), soft_wrap=True)
    for shortfall in result.shortfalls():
        console.print(f"Not served in full: {shortfall}.", soft_wrap=True)
    for reason in result.void_reasons():
        console.print(f"VOID: {reason}. These figures do not count.", style="bold red", soft_wrap=True)


def describe_trial(trial: Trial) -> str:
    """A trial in one line."""
    verdict = "void: " + "; ".join(trial.void) if trial.void else "; ".join(trial.shortfalls) or "served in full"
    event = "-" if trial.event_p99_ms is None else f"{trial.event_p99_ms:.0f} ms"
    return (
        f"{trial.characters:6d} characters, {trial.seconds} s: {trial.miss_ratio:.2%} of frames missed, "
        f"event to first changed frame {event} (p99): {verdict}"
    )


def describe_found(found: Found) -> str:
    """The result of a search in words."""
    sure = "" if found.result is not None or found.characters == 0 else "; that was not confirmed"
    if found.failure:
        return f"{found.characters} characters are served in full, as far as was found out before a run failed{sure}."
    if found.limited_by_generator:
        return (
            f"At least {found.characters} characters are served in full{sure}; with more the run is void, because the "
            "load itself was late. Use more --processes, or a machine of its own for the load."
        )
    if found.out_of_time:
        return f"{found.characters} characters are served in full, as far as was found out in the time given{sure}."
    if found.characters == 0:
        return "Not one character was served in full."
    return f"{found.characters} characters are served in full."


def figure_rows(result: Result) -> list[tuple[str, ...]]:
    """A name and a value for each of `result.groups()`."""
    figures = [result.figures(group) for group in result.groups()]
    return [
        ("frames due", *(f"{each.due:,}" for each in figures)),
        ("frames missed", *(f"{each.missed:,} ({each.miss_ratio:.2%})" for each in figures)),
        ("times playback stood still", *(f"{each.underruns:,}" for each in figures)),
        ("frames received a second", *(f"{each.frames_per_s:,.1f}" for each in figures)),
        ("frames played on time a second", *(f"{each.on_time_per_s:,.1f}" for each in figures)),
        ("characters opened while measured", *(f"{each.opens:,}" for each in figures)),
        ("edits", *(f"{each.edits:,}" for each in figures)),
        ("refused while measured", *(f"{each.refused:,}" for each in figures)),
    ]


def latency_rows(result: Result) -> list[tuple[str, ...]]:
    """Name, count, p50, p95, p99 and maximum in milliseconds of each of LATENCY_NAMES and of pings, if recorded.

    How early or late chunks came is drawn instead: it counts from no event.
    """
    rows = []
    for what, name in LATENCY_NAMES.items():
        for group in result.groups():
            row = _latency_row(name if group == ALL else f"{name}, {group}", result.latency_ms(what, group))
            if row:
                rows.append(row)
    row = _latency_row("ping to pong of a stream", result.latency_ms(ROUND_TRIP, STREAMS))
    return [*rows, row] if row else rows


def generator_rows(result: Result) -> list[tuple[str, ...]]:
    """As latency_rows, for the lag of the load itself."""
    found = (_latency_row(what.replace("_", " "), result.latency_ms(what, GENERATOR)) for what in GENERATOR_LAGS)
    return [row for row in found if row]


def use_line(result: Result) -> str:
    """Processor time and memory."""
    own = ", ".join(f"{cores:.2f}" for cores in result.generator_cores)
    line = f"cores used by the load: {own}"
    if result.server_use is not None:
        line += f"; by the server: {result.server_use.cores:.2f}, {result.server_use.peak_mib:.0f} MiB at most"
        if result.server_use.thrown_away is not None:
            line += f"; steps thrown away: {result.server_use.thrown_away:.1%}"
    return line


LATENCY_COLUMNS = ("count", "p50", "p95", "p99", "max")


def _latency_row(name: str, summary: dict[str, float]) -> tuple[str, ...]:
    if not summary["count"]:
        return ()
    return (name, f"{summary['count']:,.0f}", *(f"{summary[column]:.1f}" for column in LATENCY_COLUMNS[1:]))


def _table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    table = make_table("", *columns)
    for row in rows:
        table.add_row(*row)
    return table
