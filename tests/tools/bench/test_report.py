"""The files of a report: complete, self-contained, and clear about a void run."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hdrh.histogram import HdrHistogram

from motiongen_tools.bench import terminal
from motiongen_tools.bench.charts import draw_run
from motiongen_tools.bench.recorder import SLACK
from motiongen_tools.bench.report import write_report
from motiongen_tools.bench.result import Standard
from motiongen_tools.bench.scenario import load_scenario
from motiongen_tools.bench.search import Found, judge
from motiongen_tools.console import make_console
from tests.tools.bench.made_up import make_result

PNG = b"\x89PNG\r\n\x1a\n"
VOID_TAGS = {"meta", "br"}


class Page(HTMLParser):
    """Checks that every element is closed; collects text and what would be fetched."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.fetched: list[str] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID_TAGS:
            self.open.append(tag)
        links = {"src", "href", "xlink:href"}
        self.fetched += [value or "" for name, value in attrs if name in links and not (value or "").startswith("#")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_a_report_is_complete_and_self_contained(tmp_path: Path) -> None:
    result = make_result(scenario="mixed", missed=30)
    written = write_report(tmp_path / "new" / "folder", Standard(), result)
    assert [path.name for path in written] == ["result.json", "report.html", "report.png"]
    document = json.loads(written[0].read_text(), parse_constant=lambda name: pytest_fail(name))["result"]
    assert document["figures"]["all"]["missed"] == 30
    assert document["latencies_ms"]["event_to_first_frame"]["near"]["p50"] == 50.015
    assert HdrHistogram.decode(document["histograms"]["event_to_first_frame/crowd"]).get_total_count() == 100
    page = Page(written[1].read_text())
    assert page.fetched == []
    assert "mixed, 10 characters: 1.00% of frames missed" in page.text
    assert "Not served in full: 1.00% of frames were missed" in page.text
    assert "a <fast> one" in page.text
    assert "VOID" not in page.text
    assert written[2].read_bytes().startswith(PNG)


@pytest.mark.parametrize(("chunks", "marks"), [(3, {"0", "1", "2", "3"}), (5000, {"$\\mathdefault{10^{3}}$"})])
def test_numbers_of_chunks_are_marked_whether_few_or_many(chunks: int, marks: set[str]) -> None:
    result = make_result()
    for _ in range(chunks):
        result.recorder.record(SLACK, "crowd", 0.4)
    figure = draw_run(result)
    figure.canvas.draw()
    (axes,) = (axes for axes in figure.axes if axes.get_title("left").startswith("chunks"))
    shown = {text.get_text() for text in axes.get_yticklabels()}
    assert marks <= shown
    assert not any("." in text for text in shown)


def test_names_with_markup_are_shown_literally(tmp_path: Path) -> None:
    played = load_scenario("mixed")
    groups = tuple(replace(group, name=rf"$\frac{{{group.name}$ [/red]") for group in played.groups)
    result = make_result(scenario=replace(played, name="$_{$ <b>[/b]", groups=groups), lag_ms=9.0)
    written = write_report(tmp_path, Standard(), result)
    assert "$_{$ <b>[/b], 10 characters" in Page(written[1].read_text()).text
    console = make_console()
    with console.capture() as captured:
        console.print(terminal.describe(result.load), soft_wrap=True)
        terminal.print_result(console, result)
    assert "$_{$ <b>[/b] (revision" in captured.get()
    assert "[/red]" in captured.get()


def pytest_fail(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


def test_a_page_says_below_its_title_that_a_run_is_void_before_what_was_not_served(tmp_path: Path) -> None:
    result = make_result(lag_ms=9.0, missed=30)
    written = write_report(tmp_path, Standard(), result)
    text = Page(written[1].read_text()).text
    said = re.search(
        rf"motiongen bench: {re.escape(result.headline())}\s*VOID: the generator's send lag was 9\.0 ms \(p99\); "
        r"5 ms is allowed[^.]*\. These figures do not count\.",
        text,
    )
    assert said
    assert "Not served in full" in text[said.end() :]
    assert json.loads(written[0].read_text())["result"]["void"]


def test_a_report_of_a_search_lists_its_trials(tmp_path: Path) -> None:
    result = make_result(characters=20)
    trials = (judge(make_result(characters=40, missed=90)), judge(make_result(lag_ms=8.0)), judge(result))
    written = write_report(tmp_path, Standard(), result, Found(20, result, trials, False))
    assert [path.name for path in written][2:] == ["report.png", "search.png"]
    search = json.loads(written[0].read_text())["search"]
    assert [trial["characters"] for trial in search["trials"]] == [40, 10, 20]
    assert "20 characters are served in full" in Page(written[1].read_text()).text


def test_a_search_that_serves_no_character_is_reported(tmp_path: Path) -> None:
    found = Found(0, None, (judge(make_result(characters=1, missed=900)),), False)
    written = write_report(tmp_path, Standard(), None, found)
    assert [path.name for path in written] == ["result.json", "report.html", "search.png"]
    assert "Not one character was served in full." in Page(written[1].read_text()).text
