"""The bench of the engine from beginning to end, as short as possible: it runs and reports its measurements."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.bench.engine_picture import main as draw_from_file
from tests.bench.engine_run import Report, Settings, run
from tests.bench.engine_table import markdown, write
from tests.bench.trial import Effort

SHORT = Effort(warm_up_s=0.1, measure_s=0.2, latency_s=0.2, num_trials=1, offline_s=0.0, profile_s=0.05, product_s=0.0)


@pytest.fixture(scope="module")
def report() -> Report:
    return run(Settings("tiny", "cpu", "float32", ("B0", "B4"), 2, 4, 1, SHORT, processor_time=True))


def test_every_contestant_has_trials_and_measured_costs(report: Report) -> None:
    assert [one.name for one in report.standings] == ["B0", "B4"]
    for one in report.standings:
        assert one.trials
        assert one.offline_windows_per_s > 0
        assert one.characters == max((trial.characters for trial in one.trials if trial.passed), default=0)
        assert sum(trial.broken for trial in one.trials) == 0


def test_efficiency_is_useful_flops_over_those_of_the_matrix_product(report: Report) -> None:
    for one in report.ceilings:
        assert one.efficiency * one.product_flops_per_s == pytest.approx(one.window_flops * one.rate.windows_per_s)
        assert one.step_flops > 0
        assert one.window_flops > report.settings.num_steps * one.step_flops


def test_table_file_and_picture_are_written(report: Report, tmp_path: Path) -> None:
    write(report, tmp_path)
    table = (tmp_path / "engine.md").read_text(encoding="utf-8")
    assert table == markdown(report)
    for name in ("B0", "B4", "random weights, tiny"):
        assert f"| {name}" in table
    found = json.loads((tmp_path / "engine.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in found["standings"]] == ["B0", "B4"]
    picture = tmp_path / "engine.png"
    assert draw_from_file([str(tmp_path / "engine.json"), str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
