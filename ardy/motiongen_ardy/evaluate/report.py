"""The result of an evaluation: a table for the terminal, JSON files, and several files side by side as Markdown."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.evaluate.figure import Figure

BEGIN, END = "<!-- table -->", "<!-- end of table -->"
_STATUS = {"yes": "yes", "no": "NO", "feet": "feet", "": ""}


class ReportError(ValueError):
    """Raised for a file that is not a report of this module, or a page without a place for a table."""


@dataclass(frozen=True)
class Report:
    """about: model, data, steps, guidance, seconds and whatever else distinguishes runs.

    unjudged: rows with a bound for which the set has no clips.
    """

    about: dict[str, Any]
    figures: Sequence[Figure]
    unjudged: Sequence[str] = ()

    @property
    def missed(self) -> list[Figure]:
        """The figures that miss their bound, or whose feet or accelerations miss theirs."""
        return [figure for figure in self.figures if figure.status in ("no", "feet")]

    def write(self, path: Path) -> None:
        """Write the report as JSON, one figure per line."""
        lines = [json.dumps(figure.as_json(), ensure_ascii=False, allow_nan=False) for figure in self.figures]
        head = json.dumps(self.about, ensure_ascii=False)
        text = f'{{"about": {head},\n"figures": [\n' + ",\n".join(lines) + "\n]}\n"
        with written_whole(path) as partial:
            partial.write_text(text, encoding="utf-8")

    def table(self) -> Table:
        """The report as a table for the terminal."""
        title = escape(", ".join(f"{key} {value}" for key, value in self.about.items()))
        table = Table(title=title, caption="feet: the goal is met, but feet or accelerations of its takes are not")
        for name in ("row", "group", "n", "mean", "+-", "worst 5 %", "data", "feet", "acc p99", "bound", "met"):
            table.add_column(name, justify="left" if name in ("row", "group", "bound", "met") else "right")
        for figure in self.figures:
            company = figure.company
            table.add_row(
                f"{figure.family}: {figure.row}" + (f" [{figure.unit}]" if figure.unit else "").replace("[", "\\["),
                figure.group,
                str(figure.num),
                _short(figure.mean),
                _short(figure.interval),
                _short(figure.worst_5),
                _short(figure.data),
                _short(None if company is None else company.feet),
                _short(None if company is None else company.acceleration),
                "" if figure.bound is None else str(figure.bound),
                _STATUS[figure.status],
            )
        return table


def _short(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.1f}" if abs(value) >= 10 else f"{value:.3f}"


def read_report(path: Path) -> dict[str, Any]:
    """A report written by `Report.write`. Raises ReportError."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if {"about", "figures"} <= set(content):
            return dict(content)
    except (OSError, ValueError, TypeError) as error:
        raise ReportError(f"{path}: cannot be read as a report: {error}") from error
    raise ReportError(f"{path}: not a report; make one with `python -m motiongen_ardy.evaluate MODEL DATA --json FILE`")


def side_by_side(reports: dict[str, dict[str, Any]]) -> str:
    """A Markdown table with the mean, interval, feet and accelerations of each report, by its name.

    Rows that a report does not have are left empty.
    """
    entries: dict[tuple[str, str, str], dict[str, dict[str, Any]]] = {}
    for name, report in reports.items():
        for figure in report["figures"]:
            entries.setdefault((figure["family"], figure["row"], figure["group"]), {})[name] = figure
    lines = [
        "| | of | unit | " + " | ".join(reports) + " | data | target |",
        "|---|---|---|" + "---|" * len(reports) + "---|---|",
    ]
    for (family, row, group), by_name in entries.items():
        first = next(iter(by_name.values()))
        cells = [_cell(by_name.get(name)) for name in reports]
        data = _short(first.get("data"))
        row = row.replace("|", "\\|")
        lines.append(
            f"| {family}: {row} | {group} | {first['unit']} | "
            + " | ".join(cells)
            + f" | {data} | {first.get('bound', '')} |"
        )
    return "\n".join(lines)


def _cell(figure: dict[str, Any] | None) -> str:
    """Mean and interval, followed by feet and acceleration; bold if the bounds of all three are met."""
    if figure is None:
        return ""
    text = _short(figure["mean"]) + (f" ± {_short(figure['interval'])}" if "interval" in figure else "")
    text = f"**{text}**" if figure["status"] == "yes" else text
    company = figure.get("company")
    if company is None:
        return text
    feet = "-" if company["feet"] is None else f"{company['feet']:.2f}"
    acceleration = "-" if company["acceleration"] is None else f"{company['acceleration']:.0f}"
    return f"{text} ({feet}, {acceleration})"


def put_between_marks(page: Path, text: str) -> None:
    """Replace the text between the marks of a Markdown page. Raises ReportError if the page has no marks."""
    content = page.read_text(encoding="utf-8")
    before, begin, rest = content.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ReportError(f"{page}: no place for a table; put a line {BEGIN} and a line {END} into it")
    page.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}", encoding="utf-8")
