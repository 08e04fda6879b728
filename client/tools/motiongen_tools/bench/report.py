"""The report of a run or a search: result.json, report.png, and report.html, which needs no other file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from motiongen_tools.bench import charts, terminal
from motiongen_tools.bench.result import Result, Standard
from motiongen_tools.bench.search import Found
from motiongen_tools.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = 1

_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; color: #1f2328; max-width: 1080px; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.3rem; }
h2 { font-size: 1.05rem; margin-top: 2rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .9rem .2rem 0; text-align: right; border-bottom: 1px solid #eceef0; font-weight: normal; }
th { color: #7c828b; }
th:first-child, td:first-child { text-align: left; }
svg { width: 100%; height: auto; }
.void { color: #fff; background: #cf4a4a; padding: .6rem .9rem; }
.quiet { color: #7c828b; }
</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")


def write_report(out: Path, standard: Standard, result: Result | None, found: Found | None = None) -> list[Path]:
    """Write the files into a folder, which is created. Returns them.

    result: the run, or the one that confirmed the answer of a search; None if the search found nothing to confirm.
    """
    out.mkdir(parents=True, exist_ok=True)
    figures = _draw(standard, result, found)
    contents = {
        "result.json": (json.dumps(document(result, found), indent=1) + "\n").encode(),
        "report.html": _page(result, found, figures.values()).encode(),
        **{f"{name}.png": charts.as_png(figure) for name, figure in figures.items()},
    }
    for name, content in contents.items():
        with whole_file(out / name) as part:
            part.write_bytes(content)
    return [out / name for name in contents]


def document(result: Result | None, found: Found | None) -> dict[str, Any]:
    """The contents of result.json."""
    return {
        "format": FORMAT,
        "result": None if result is None else result.document(),
        "search": None if found is None else asdict(replace(found, result=None)),
    }


def _draw(standard: Standard, result: Result | None, found: Found | None) -> dict[str, Figure]:
    figures = {}
    if result is not None:
        figures["report"] = charts.draw_run(result)
    if found is not None:
        figures["search"] = charts.draw_search(found, standard.max_miss_ratio)
    return figures


def _page(result: Result | None, found: Found | None, figures: Iterable[Figure]) -> str:
    parts = []
    title = "the most characters" if result is None else result.headline()
    if result is not None:
        parts += [
            f'<p class="void">VOID: {escape(why)}. These figures do not count.</p>' for why in result.void_reasons()
        ]
        parts += [f"<p>Not served in full: {escape(shortfall)}.</p>" for shortfall in result.shortfalls()]
    if found is not None:
        parts.append(f"<p>{escape(terminal.describe_found(found))}</p>")
        parts.append(_table(("trials",), [(terminal.describe_trial(trial),) for trial in found.trials]))
    parts += [charts.as_svg(figure) for figure in figures]
    if result is not None:
        parts += _tables(result)
    return _PAGE.substitute(title=escape(f"motiongen bench: {title}"), body="\n".join(parts))


def _tables(result: Result) -> list[str]:
    columns = terminal.LATENCY_COLUMNS
    scenario, load = result.load.scenario, result.load
    asked = {
        "scenario": f"{scenario.name}, revision {scenario.revision}: {scenario.description}",
        "characters": f"{load.characters} on {result.streams} streams of {load.processes} processes",
        "measured": f"{load.seconds} s after {result.phases.measure_from_s} s of warming up, from {result.started_at}",
        "seed": str(load.seed),
    }
    return [
        "<h2>Figures</h2>",
        _table(("measured", *result.groups()), terminal.figure_rows(result)),
        "<h2>Latencies, ms</h2>",
        '<p class="quiet">Counted from the moment an event was meant to be sent.</p>',
        _table(("from, to", *columns), terminal.latency_rows(result)),
        "<h2>The load itself, ms late</h2>",
        f'<p class="quiet">{escape(terminal.use_line(result))}</p>',
        _table(("lag", *columns), terminal.generator_rows(result)),
        "<h2>Counted in the whole run</h2>",
        _table(("what", "count"), [(name.replace("_", " "), f"{count:,}") for name, count in result.counts()]),
        "<h2>What was run</h2>",
        _table(("", ""), [*asked.items(), *result.server.items(), *result.machine.items()]),
    ]


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table>\n<tr>{head}</tr>\n{body}\n</table>"
