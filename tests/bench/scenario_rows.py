"""Reports of `motiongen bench` as rows of one table."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

Report = dict[str, Any]

# Latencies are p50 / p99.
HEADER = (
    "| scenario | characters | precision | missed | below FULL | refused | edits, ms | first frame, ms "
    "| thrown away | cores | others' | void |",
    "|---|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|---|",
)
FOUND_HEADER = (
    "| scenario | precision | most served in full | limited by the load | confirmed | trials |",
    "|---|---|---:|---|---|---:|",
)
_EVENT, _OPEN = "event_to_first_frame", "open_to_first_frame"
_REFUSED = "refused open: "
_LEVEL, _FULL = "service level: ", "service level: FULL"


def rows_of(scenario: str, characters: int, precision: str, reports: Sequence[Report]) -> list[str]:
    """A row for all characters, and one for each group if there are several.

    For several seeds: medians of medians and of cores, the worst tail latencies and shares thrown away, and totals of
    what was missed and refused.
    """
    groups = [name for name in reports[0]["figures"] if name != "all"]
    lines = [_line([scenario, f"{characters}", precision, *_cells(reports, "all"), *_run_cells(reports)])]
    if len(groups) > 1:
        lines += [_line([f"- {name}", "", "", *_cells(reports, name), "", "", "", ""]) for name in groups]
    return lines


def found_row(scenario: str, precision: str, report: Report) -> str:
    """The result of a search as a row."""
    found = report["search"]
    ended = found["limited_by_generator"] or found.get("out_of_time")
    most = f"at least {found['characters']}" if ended else f"{found['characters']}"
    yes_or_no = ["yes" if each else "no" for each in (found["limited_by_generator"], "figures" in report)]
    return _line([scenario, precision, most, *yes_or_no, f"{len(found['trials'])}"])


def _cells(reports: Sequence[Report], group: str) -> list[str]:
    figures = [report["figures"][group] for report in reports]
    due, missed = (sum(each[name] for each in figures) for name in ("due", "missed"))
    is_all = group == "all"  # refused and degraded sessions are not counted by group
    below, refused = (f"{sum(map(of, reports))}" if is_all else "" for of in (_below_full, _refused))
    share = f"{missed / due:.2%}" if missed and due else "0" if due else "-"
    return [share, below, refused, _latencies(reports, _EVENT, group), _latencies(reports, _OPEN, group)]


def _run_cells(reports: Sequence[Report]) -> list[str]:
    uses = [report["server_use"] for report in reports if report["server_use"]]
    cores = [use["cores"] for use in uses]
    thrown_away = [share for use in uses if (share := use.get("thrown_away")) is not None]  # not in earlier commits
    void = sum(bool(report["void"]) for report in reports)
    return [
        f"{max(thrown_away):.1%}" if thrown_away else "-",
        f"{median(cores):.2f}" if cores else "-",
        f"{max(report['others'] for report in reports):.0%}",
        f"{void} of {len(reports)}" if void else "no",
    ]


def _refused(report: Report) -> int:
    """Refused opens, counted from the first second on: most happen before the measured part."""
    return sum(count for name, count in report["counts"].items() if name.startswith(_REFUSED))


def _below_full(report: Report) -> int:
    """How often a session was told of a level below FULL."""
    return sum(
        count for name, count in report["counts"].items() if name.startswith(_LEVEL) and not name.startswith(_FULL)
    )


def _latencies(reports: Sequence[Report], what: str, group: str) -> str:
    seen = [each for report in reports if (each := report["latencies_ms"][what][group])["count"]]
    if not seen:
        return "-"
    return f"{median(each['p50'] for each in seen):.0f} / {max(each['p99'] for each in seen):.0f}"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
