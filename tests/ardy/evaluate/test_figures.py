"""Figures: intervals, bounds, status, and reports that are written, read and compared."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.evaluate.figure import Bound, Company, Figure, Sample, seed_interval, summarize
from motiongen_ardy.evaluate.report import BEGIN, END, Report, ReportError, put_between_marks, read_report, side_by_side

NAME = ("path", "circle", "moving")


def made(value: float, bound: Bound | None = None, company: Company | None = None) -> Figure:
    figure = summarize(NAME, "m", [Sample("a", value), Sample("a", value)], bound=bound, company=company)
    assert figure is not None
    return figure


def test_a_bound_is_met_within_its_limits() -> None:
    assert Bound(most=1.0).met(1.0)
    assert not Bound(most=1.0).met(1.1)
    assert Bound(0.9, 1.1).met(1.0)
    assert not Bound(0.9, 1.1).met(0.8)
    assert [str(Bound(most=0.02)), str(Bound(least=0.8)), str(Bound(0.9, 1.1))] == ["<= 0.02", ">= 0.8", "0.9 to 1.1"]


def test_a_met_bound_counts_only_if_the_feet_do_not_slide() -> None:
    bound = Bound(most=0.1)
    assert made(0.05).status == ""
    assert made(0.05, bound).status == "yes"
    assert made(0.05, bound, Company(0.05, 30.0, kept=True)).status == "yes"
    assert made(0.05, bound, Company(0.50, 30.0, kept=False)).status == "feet"
    assert made(0.20, bound, Company(0.05, 30.0, kept=True)).status == "no"


def test_samples_that_are_nan_are_left_out() -> None:
    assert summarize(NAME, "m", [Sample("a", math.nan)]) is None
    figure = summarize(NAME, "m", [Sample("a", math.nan), Sample("b", 2.0)])
    assert figure is not None
    assert (figure.num, figure.mean, figure.interval) == (1, 2.0, None)


def test_the_worst_values_are_those_in_the_bad_direction() -> None:
    samples = [Sample(str(number), float(number)) for number in range(101)]
    low = summarize(NAME, "m", samples, more_is_better=True)
    high = summarize(NAME, "m", samples)
    assert low is not None
    assert high is not None
    assert (low.worst_5, low.worst, high.worst_5, high.worst) == (5.0, 0.0, 95.0, 100.0)


def test_the_interval_covers_the_mean_of_other_seeds() -> None:
    random = np.random.default_rng(0)
    means = random.normal(size=12) * 5  # cases differ much more than seeds do
    covered, trials = 0, 400
    for _ in range(trials):
        draws = [Sample(str(case), mean + random.normal()) for case, mean in enumerate(means) for _ in range(2)]
        interval = seed_interval(draws)
        assert interval is not None
        covered += abs(float(np.mean([draw.value for draw in draws])) - means.mean()) <= interval
    assert 0.92 <= covered / trials <= 0.98


def test_one_seed_has_no_interval() -> None:
    assert seed_interval([Sample("a", 1.0), Sample("b", 2.0)]) is None


def test_a_report_is_read_back_and_compared_with_another(tmp_path: Path) -> None:
    path = tmp_path / "one.json"
    figures = [made(0.05, Bound(most=0.1), Company(0.04, 30.0, kept=True))]
    Report({"model": "m"}, figures).write(path)
    report = read_report(path)
    assert report["about"] == {"model": "m"}
    assert report["figures"][0]["bound"] == "<= 0.1"
    table = side_by_side({"one": report, "two": {"about": {}, "figures": []}}).splitlines()
    assert table[-1] == "| path: circle | moving | m | **0.050 ± 0.000** (0.04, 30) |  |  | <= 0.1 |"


def test_missed_figures_fail_a_report() -> None:
    bound = Bound(most=0.1)
    slides = made(0.05, bound, Company(0.5, 30.0, kept=False))
    assert Report({}, [made(0.05, bound), made(0.3)]).missed == []
    assert Report({}, [slides, made(0.3, bound)]).missed == [slides, made(0.3, bound)]


@pytest.mark.parametrize("content", ["", "[]", "3", json.dumps({"figures": []})])
def test_a_file_that_is_not_a_report_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "bad.json").write_text(content)
    with pytest.raises(ReportError, match=r"bad\.json"):
        read_report(tmp_path / "bad.json")


def test_a_table_replaces_the_text_between_the_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    put_between_marks(page, "new")
    put_between_marks(page, "newer")
    assert page.read_text() == f"before\n{BEGIN}\n\nnewer\n\n{END}\nafter\n"
    page.write_text("no place")
    with pytest.raises(ReportError, match="no place for a table"):
        put_between_marks(page, "new")
